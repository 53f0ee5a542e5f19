// MCAP on the level of bytes: magic, opcodes, little-endian put and get. From the MCAP format specification.
#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace weakgrid::mcap {

using Bytes = std::vector<std::byte>;
using ByteView = std::span<const std::byte>;
using StringMap = std::map<std::string, std::string>;  // ordered: equal content gives equal files

/// Stands at both ends of a file.
inline constexpr std::array<std::byte, 8> magic{std::byte{0x89}, std::byte{'M'}, std::byte{'C'},
                                                std::byte{'A'},  std::byte{'P'}, std::byte{'0'},
                                                std::byte{'\r'}, std::byte{'\n'}};

/// 0 is no opcode: zeros are what a power cut leaves at the end of a file. 0x80 and above are private.
enum class Op : std::uint8_t {
  invalid = 0x00,
  header = 0x01,
  footer = 0x02,
  schema = 0x03,
  channel = 0x04,
  message = 0x05,
  chunk = 0x06,
  message_index = 0x07,
  chunk_index = 0x08,
  attachment = 0x09,
  attachment_index = 0x0a,
  statistics = 0x0b,
  metadata = 0x0c,
  metadata_index = 0x0d,
  summary_offset = 0x0e,
  data_end = 0x0f,
};

inline constexpr std::size_t record_head_bytes = 1 + 8;           // opcode, length of the body
inline constexpr std::size_t message_head_bytes = 2 + 4 + 8 + 8;  // channel, sequence, log, publish time
inline constexpr std::size_t footer_bytes = 8 + 8 + 4;            // the body; a footer never grows

template <std::unsigned_integral T>
void store(std::byte* at, T value) {
  for (std::size_t k = 0; k < sizeof(T); ++k) at[k] = static_cast<std::byte>(value >> (8 * k) & 0xff);
}

template <std::unsigned_integral T>
T load(const std::byte* at) {
  std::uint64_t value = 0;
  for (std::size_t k = 0; k < sizeof(T); ++k) value |= std::to_integer<std::uint64_t>(at[k]) << (8 * k);
  return static_cast<T>(value);
}

/// `count` new bytes at the end; the pointer holds until the next change of `out`.
inline std::byte* extend(Bytes& out, std::size_t count) {
  const std::size_t size = out.size();
  out.resize(size + count);
  return out.data() + size;
}

template <std::unsigned_integral T>
void put(Bytes& out, T value) {
  store(extend(out, sizeof(T)), value);
}

inline void put_bytes(Bytes& out, ByteView bytes) { out.insert(out.end(), bytes.begin(), bytes.end()); }

inline void put_string(Bytes& out, std::string_view text) {
  put(out, static_cast<std::uint32_t>(text.size()));
  put_bytes(out, std::as_bytes(std::span{text}));
}

/// Reserves a 4-byte length for what is put during its life, as maps and arrays want it.
class LengthPrefix {
 public:
  explicit LengthPrefix(Bytes& out) : out_{out}, at_{out.size()} { put<std::uint32_t>(out, 0); }
  ~LengthPrefix() { store(out_.data() + at_, static_cast<std::uint32_t>(out_.size() - at_ - 4)); }
  LengthPrefix(const LengthPrefix&) = delete;
  LengthPrefix& operator=(const LengthPrefix&) = delete;

 private:
  Bytes& out_;
  std::size_t at_;
};

/// Opcode and length around what is put during its life.
class RecordFrame {
 public:
  RecordFrame(Bytes& out, Op op) : out_{out}, at_{out.size()} {
    put(out, static_cast<std::uint8_t>(op));
    put<std::uint64_t>(out, 0);
  }
  ~RecordFrame() {
    store(out_.data() + at_ + 1, static_cast<std::uint64_t>(out_.size() - at_ - record_head_bytes));
  }
  RecordFrame(const RecordFrame&) = delete;
  RecordFrame& operator=(const RecordFrame&) = delete;

 private:
  Bytes& out_;
  std::size_t at_;
};

/// Reads hostile bytes: what does not fit gives zero or nothing, and ok() says so from then on.
class Cursor {
 public:
  Cursor() = default;
  explicit Cursor(ByteView bytes) : left_{bytes} {}

  bool ok() const { return ok_; }
  void fail() { ok_ = false; }
  std::size_t left() const { return left_.size(); }

  template <std::unsigned_integral T>
  T take() {
    const ByteView bytes = take_bytes(sizeof(T));
    return ok_ ? load<T>(bytes.data()) : T{0};
  }

  /// The length comes from the file: compared before it is used, so it can neither wrap nor overrun.
  ByteView take_bytes(std::uint64_t count) {
    if (!ok_ || count > left_.size()) {
      ok_ = false;
      left_ = {};
      return {};
    }
    const ByteView bytes = left_.first(static_cast<std::size_t>(count));
    left_ = left_.subspan(bytes.size());
    return bytes;
  }

  std::string_view take_string() {
    const ByteView bytes = take_bytes(take<std::uint32_t>());
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }

  /// A map or array: its bytes as a cursor of their own.
  Cursor take_prefixed() {
    Cursor inside{take_bytes(take<std::uint32_t>())};
    inside.ok_ = ok_;
    return inside;
  }

 private:
  ByteView left_;
  bool ok_ = true;
};

}  // namespace weakgrid::mcap

// Compression of chunks (zstd, LZ4 frames) and the CRC-32 that MCAP uses throughout (zlib's).
#pragma once

#include <memory>
#include <optional>

#include "services/recording/mcap_format.hpp"

struct ZSTD_CCtx_s;
struct ZSTD_DCtx_s;
struct LZ4F_dctx_s;

namespace weakgrid::mcap {

enum class Compression : std::uint8_t { none, zstd, lz4 };

/// As the file spells it: "", "zstd", "lz4".
std::string_view name_of(Compression compression);
std::optional<Compression> compression_named(std::string_view name);

/// Continues `crc` over `bytes`. 0 in a file means "not checked", also where the true CRC happens to be 0.
std::uint32_t crc32(ByteView bytes, std::uint32_t crc = 0);

/// Keeps its context, so that calls allocate nothing; only libzstd resizes its workspace now and then when
/// the sizes of chunks vary much (measured: 3 times in 100 such chunks).
class Compressor {
 public:
  explicit Compressor(Compression compression = Compression::none);

  Compression compression() const { return compression_; }
  /// Room that compress() wants for `count` bytes.
  std::size_t bound(std::size_t count) const;
  /// Bytes written to `out`; 0 = not compressed (no room, no memory, or Compression::none): store as it is.
  std::size_t compress(ByteView in, std::span<std::byte> out);

 private:
  struct Free {
    void operator()(ZSTD_CCtx_s* context) const;
  };
  Compression compression_;
  std::unique_ptr<ZSTD_CCtx_s, Free> zstd_;
};

class Decompressor {
 public:
  /// False where `uncompressed_bytes` cannot be true, to be asked before that much is allocated.
  static bool plausible(Compression compression, ByteView in, std::uint64_t uncompressed_bytes);
  /// True if `in` is exactly one frame (zstd: frames) of exactly out.size() bytes.
  [[nodiscard]] bool decompress(Compression compression, ByteView in, std::span<std::byte> out);

 private:
  struct Free {
    void operator()(ZSTD_DCtx_s* context) const;
    void operator()(LZ4F_dctx_s* context) const;
  };
  bool decompress_lz4(ByteView in, std::span<std::byte> out);
  std::unique_ptr<ZSTD_DCtx_s, Free> zstd_;
  std::unique_ptr<LZ4F_dctx_s, Free> lz4_;
};

}  // namespace weakgrid::mcap

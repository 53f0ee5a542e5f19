// What an operation on an MCAP file answers: done, or why not. A value, never an exception.
#pragma once

#include <cstdint>
#include <string>

namespace weakgrid::mcap {

enum class Fault : std::uint8_t {
  none,
  closed,      ///< no file is open
  refused,     ///< an argument makes no sense or exceeds a limit; nothing was written
  system,      ///< the operating system said no: see `error`
  not_mcap,    ///< the file does not begin as MCAP does
  no_summary,  ///< no index at the end of the file: cut off, or written without
  too_large,   ///< the file wants more memory than the reader's limits grant
};

struct [[nodiscard]] Status {
  Fault fault = Fault::none;
  int error = 0;          ///< errno where fault = system
  const char* what = "";  ///< static text: what was tried, or what is wrong

  bool ok() const { return fault == Fault::none; }
  bool disk_full() const;  ///< no space, quota or file size limit: stop recording, keep controlling
  std::string text() const;
};

}  // namespace weakgrid::mcap

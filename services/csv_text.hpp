// A text as a cell of our CSV files.
#pragma once

#include <string>
#include <string_view>

namespace weakgrid {

/// Quoted where RFC 4180 asks for it.
inline void put_csv_text(std::string& line, std::string_view text) {
  if (text.find_first_of(",\"\r\n") == text.npos) {
    line += text;
    return;
  }
  line += '"';
  for (const char c : text) {
    if (c == '"') line += '"';
    line += c;
  }
  line += '"';
}

}  // namespace weakgrid

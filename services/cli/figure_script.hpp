// The parts that all figures' gnuplot scripts share. Colours: Okabe and Ito's, which colour-blind readers
// tell apart; lines differ in dashes too, for grey prints.
#pragma once

#include <fmt/format.h>

#include <string>
#include <utility>
#include <vector>

#include "services/cli/figure.hpp"

namespace weakgrid {

/// Units of an SVG; a centimetre in a PDF has 40.
struct FigureSize {
  int width, height;
};

class FigureScript {
 public:
  FigureScript(const FigureStyle& style, FigureSize size);

  template <class... Values>
  void line(fmt::format_string<Values...> format, Values&&... values) {
    text_ += fmt::format(format, std::forward<Values>(values)...) + '\n';
  }
  /// A datablock $name of these lines; what gnuplot could not draw is left out.
  void data(const std::string& name, const std::vector<PlotLine>& lines);
  /// The frame of panel n of `count`, from the top. Above it stand its caption and, at the right, either the
  /// key or `remark`.
  void panel(int n, int count, const std::string& caption, const std::string& y_label,
             const std::string& remark = "");
  /// "font …" for what is beside the point.
  std::string small_font() const;
  std::string end() &&;

  /// What stands for `text` in a script, letter by letter.
  static std::string quoted(const std::string& text);

 private:
  FigureFormat format_;
  FigureSize size_;
  bool has_title_;
  std::string text_;
};

}  // namespace weakgrid

// FigureScript: see the header.
#include "services/cli/figure_script.hpp"

#include <filesystem>

namespace weakgrid {

namespace {

constexpr const char* font = "DejaVu Serif";

double font_size(FigureFormat format) {
  switch (format) {
    case FigureFormat::svg:
      return 13.0;
    case FigureFormat::png:
      return 9.75;
    case FigureFormat::pdf:
      return 7.0;
  }
  return 0.0;
}

// Sizes in SVG units; PNG has twice as many pixels, for screens and slides.
std::string terminal(FigureFormat format, FigureSize size) {
  const std::string text = fmt::format("enhanced font '{},{}'", font, font_size(format));
  switch (format) {
    case FigureFormat::svg:
      return fmt::format("svg size {},{} {} background '#ffffff' linewidth 1.1", size.width, size.height,
                         text);
    case FigureFormat::png:
      return fmt::format("pngcairo size {},{} {} fontscale 2 linewidth 2.2 pointscale 2", 2 * size.width,
                         2 * size.height, text);
    case FigureFormat::pdf:
      return fmt::format("pdfcairo size {:.2f}cm,{:.2f}cm {} linewidth 0.9 pointscale 0.6", size.width / 40.0,
                         size.height / 40.0, text);
  }
  return {};
}

}  // namespace

std::optional<FigureFormat> figure_format(const std::string& file) {
  const std::string end = std::filesystem::path(file).extension();
  if (end == ".svg") return FigureFormat::svg;
  if (end == ".png") return FigureFormat::png;
  if (end == ".pdf") return FigureFormat::pdf;
  return std::nullopt;
}

FigureScript::FigureScript(const FigureStyle& style, FigureSize size)
    : format_(style.format), size_(size), has_title_(!style.title.empty()) {
  line("set terminal {}", terminal(style.format, size));
  line("set output 'figure'");
  line("set encoding utf8");
  line("set border 31 lw 0.6 lc rgb '#404040'");
  line("set tics nomirror scale 0.6 textcolor rgb '#000000'");
  line("set grid lw 0.6 lc rgb '#dcdcdc' dt solid");
  line("set multiplot");
  if (has_title_)
    line("set label 100 {} at screen 0.5, screen {:.4f} center noenhanced", quoted(style.title),
         1.0 - 14.0 / size.height);
}

void FigureScript::data(const std::string& name, const std::vector<PlotLine>& lines) {
  text_ += fmt::format("${} << EOD\n", name);
  for (const PlotLine& points : lines) {
    for (const PlotPoint& point : points) text_ += fmt::format("{:.7g} {:.6g}\n", point.x, point.y);
    text_ += '\n';
  }
  if (lines.empty()) text_ += "NaN NaN\n";
  text_ += "EOD\n";
}

void FigureScript::panel(int n, int count, const std::string& caption, const std::string& y_label,
                         const std::string& remark) {
  const double top = has_title_ ? 26.0 : 4.0, bottom = 48.0, head = 25.0, left = 66.0, right = 20.0;
  const double each = (size_.height - top - bottom) / count;
  const auto x = [this](double at) { return at / size_.width; };
  const auto y = [this](double at) { return 1.0 - at / size_.height; };
  const double upper = top + each * n + head, lower = top + each * (n + 1) - 4.0;
  const double above = upper - 0.46 * head;
  if (n == 1) line("unset label 100");
  line("set lmargin at screen {:.4f}\nset rmargin at screen {:.4f}", x(left), 1.0 - x(right));
  line("set tmargin at screen {:.4f}\nset bmargin at screen {:.4f}", y(upper), y(lower));
  line("set label 1 '({:c}) {}' at screen {:.4f}, screen {:.4f} left", 'a' + n, caption, x(left), y(above));
  line("set label 2 '{}' at screen {:.4f}, screen {:.4f} right", remark, 1.0 - x(right), y(above));
  line("set label 3 '{}' at screen {:.4f}, screen {:.4f} center rotate by 90", y_label, x(15.0),
       y(0.5 * (upper + lower)));
  line("set key at screen {:.4f}, screen {:.4f} right center horizontal Left reverse samplen 2.2",
       1.0 - x(right), y(above));
}

std::string FigureScript::small_font() const {
  return fmt::format("font '{},{}'", font, 0.85 * font_size(format_));
}

std::string FigureScript::end() && {
  line("unset multiplot");
  line("unset output");
  return std::move(text_);
}

std::string FigureScript::quoted(const std::string& text) {
  std::string out = "'";
  for (const char letter : text) {
    if (letter == '\'') out += '\'';
    out += static_cast<unsigned char>(letter) < 0x20 ? ' ' : letter;
  }
  return out + '\'';
}

}  // namespace weakgrid

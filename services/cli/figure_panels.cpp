// The paper's four panels: PCC voltage and filtered PCC voltage; current; references and powers; scaled DC
// voltage and PCC voltage. Figs. "Strong grid simulation", "Weak inductive grid simulation".
#include <algorithm>
#include <cmath>

#include "services/cli/figure_script.hpp"

namespace weakgrid {

namespace {

constexpr FigureSize size{620, 860};
// Beyond that many grid periods waves would be a band of ink.
constexpr double waves_periods_max = 30.0, components_periods_max = 10.0;

struct Curve {
  std::string name;  // of the datablock
  std::vector<PlotLine> lines;
  std::string title, style;
};

struct Range {
  double low = 0.0, high = 0.0;
};

// With room, and never so narrow that rounding errors fill the panel.
Range range_of(const std::vector<Curve>& curves) {
  double low = HUGE_VAL, high = -HUGE_VAL;
  for (const Curve& curve : curves)
    for (const PlotLine& line : curve.lines)
      for (const PlotPoint& point : line) {
        low = std::min(low, point.y);
        high = std::max(high, point.y);
      }
  if (!(low <= high)) return {-1.0, 1.0};
  const double pad = std::max(0.08 * (high - low), 0.05 * std::max(0.2, std::abs(high)));
  return {low - pad, high + pad};
}

// At most six tics, at round numbers.
double tic_of(Range range) {
  const double least = (range.high - range.low) / 6.0;
  const double decade = std::pow(10.0, std::floor(std::log10(least)));
  for (const double step : {1.0, 2.0, 5.0})
    if (step * decade >= least) return step * decade;
  return 10.0 * decade;
}

std::vector<PlotLine> scaled(const ThinnedSeries& series, double factor) {
  std::vector<PlotLine> lines = series.lines();
  for (PlotLine& line : lines)
    for (PlotPoint& point : line) point.y *= factor;
  return lines;
}

class Panels {
 public:
  Panels(const PlotData& data, const FigureStyle& style) : data_(data), script_(style, size) {
    const double span = data.end_s - data.first_s;
    script_.line("set xrange [{:.9g}:{:.9g}]", data.first_s, data.first_s + span);
    for (std::size_t n = 0; n < data.losses.size(); ++n) {
      const PlotLoss& loss = data.losses[n];
      script_.line("set object {} rect from first {:.9g}, graph 0 to first {:.9g}, graph 1 behind {}", n + 1,
                   loss.from_s, std::max(loss.until_s, loss.from_s + 0.002 * span), lost);
    }
    for (std::size_t n = 0; n < data.marks.size(); ++n)
      script_.line(
          "set arrow {0} from first {1:.9g}, graph 0 to first {1:.9g}, graph 1 nohead lw 0.9 dt 3 lc rgb "
          "'#404040' back",
          n + 1, data.marks[n].t_s);
    periods_ = span * data.frequency_hz;
  }

  std::string script() && {
    draw("PCC voltage ({/:Italic v̂_p} filtered)", waves(data_.v_p, "v_p", &data_.v_p_hat, "v̂_p"));
    draw("Injected current", waves(data_.i, "i", nullptr, ""));
    draw("Reference power and injected power",
         {{"p", data_.p.lines(), "{/:Italic p}", measured},
          {"q", data_.q.lines(), "{/:Italic q}", second},
          {"pr", data_.p_r.lines(), "{/:Italic p_r}", "lc rgb '#000000' lw 1.2 dt (7,5)"},
          {"qr", data_.q_r.lines(), "{/:Italic q_r}", "lc rgb '#000000' lw 1.4 dt (2,4)"}});
    draw("Scaled DC voltage, magnitude of PCC voltage",
         {{"vc", scaled(data_.v_c, std::sqrt(0.5)), "{/:Italic v_c}/√2", measured},
          {"vp4", data_.v_p.magnitude.lines(), "|{/:Italic v_p}|", dashed}});
    return std::move(script_).end();
  }

 private:
  static constexpr const char* lost = "fc rgb '#eed6e2' fs solid noborder";
  static constexpr const char* measured = "lc rgb '#0072b2' lw 1.6";
  static constexpr const char* second = "lc rgb '#d55e00' lw 1.6";
  static constexpr const char* dashed = "lc rgb '#d55e00' lw 1.5 dt (6,4)";

  // Components while single waves can be seen; magnitudes, with one wave behind them, while that can.
  std::vector<Curve> waves(const PlotData::Signal& of, const std::string& letter,
                           const PlotData::Signal* filtered, const std::string& filtered_letter) const {
    const auto title = [](const std::string& x, const char* component) {
      const std::size_t at = x.find('_');
      const std::string index = at == std::string::npos ? "" : x.substr(at + 1);
      return fmt::format("{{/:Italic {}}}_{{{{/:Italic {}}}{}}}", x.substr(0, at), index, component);
    };
    const auto magnitude = [&](const std::string& x) { return fmt::format("|{}|", title(x, "")); };
    std::vector<Curve> curves;
    if (periods_ <= components_periods_max) {
      curves.push_back({letter + "a", of.alpha.lines(), title(letter, "α"), measured});
      curves.push_back({letter + "b", of.beta.lines(), title(letter, "β"), second});
      if (filtered == nullptr) return curves;
      const char* over = "lc rgb '#000000' lw 1.1 dt (5,4)";
      const char* under = "lc rgb '#000000' lw 1.2 dt (2,3)";
      curves.push_back({"hata", filtered->alpha.lines(), title(filtered_letter, "α"), over});
      curves.push_back({"hatb", filtered->beta.lines(), title(filtered_letter, "β"), under});
      return curves;
    }
    if (periods_ <= waves_periods_max)
      curves.push_back({letter + "a", of.alpha.lines(), title(letter, "α"), "lc rgb '#a8a8a8' lw 0.7"});
    curves.push_back({letter + "m", of.magnitude.lines(), magnitude(letter), measured});
    if (filtered != nullptr)
      curves.push_back({"hatm", filtered->magnitude.lines(), magnitude(filtered_letter), dashed});
    return curves;
  }

  void draw(const std::string& caption, std::vector<Curve> curves) {
    constexpr int count = 4;
    Range range = range_of(curves);
    if (n_ == 0) range.high += (range.high - range.low) * mark_texts();
    const double tolerance = (range.high - range.low) * 1e-3;
    std::string plot;
    for (Curve& curve : curves) {
      if (curve.lines.empty()) continue;
      for (PlotLine& line : curve.lines) line = simplified(line, tolerance);
      script_.data(curve.name, curve.lines);
      plot += fmt::format("{}${} with lines {} title '{}'", plot.empty() ? "plot " : ", \\\n  ", curve.name,
                          curve.style, curve.title);
    }
    script_.panel(n_, count, caption, "p.u.");
    script_.line("set yrange [{:.6g}:{:.6g}]", range.low, range.high);
    script_.line("set ytics {:.6g}", tic_of(range));
    if (n_ == 0 && !data_.losses.empty())
      plot += fmt::format(", \\\n  keyentry with boxes {} title 'lost'", lost);
    const bool is_last = ++n_ == count;
    script_.line("{}", is_last ? "set format x '%g'\nset xlabel 'time (s)' offset 0,0.3"
                               : "set format x ''\nunset xlabel");
    script_.line("{}", plot);
    if (data_.marks.empty()) return;
    script_.line("do for [k=200:{}] {{ unset label k }}", 200 + data_.marks.size());
  }

  // In rows above what the first panel shows; gives the room they take, as a share of the panel.
  double mark_texts() {
    constexpr double row_height = 0.085;
    const double span = data_.end_s - data_.first_s, letter = 0.0125 * span;
    std::vector<double> taken;  // by row, until when
    for (std::size_t n = 0; n < data_.marks.size(); ++n) {
      const auto& [t, text] = data_.marks[n];
      const double width = letter * static_cast<double>(text.size());
      const bool is_left = t + width > data_.end_s;
      const double from = is_left ? t - width : t;
      const auto row = static_cast<std::size_t>(
          std::find_if(taken.begin(), taken.end(), [from](double until) { return from > until; }) -
          taken.begin());
      if (row == taken.size()) taken.push_back(0.0);
      taken[row] = from + width;
      script_.line(
          "set label {} '{}' at first {:.9g}, graph {:.4f} {} offset {},0 {} textcolor rgb '#404040'",
          200 + n, text, t, 1.0 - row_height * (0.6 + static_cast<double>(row)), is_left ? "right" : "left",
          is_left ? -0.4 : 0.4, script_.small_font());
    }
    return std::min(0.5, row_height * static_cast<double>(taken.size()));
  }

  const PlotData& data_;
  FigureScript script_;
  double periods_ = 0.0;
  int n_ = 0;
};

}  // namespace

std::string panels_script(const PlotData& data, const FigureStyle& style) {
  return Panels(data, style).script();
}

}  // namespace weakgrid

// The p-q plane: what the gateway admits (Section III, Fig. "Reactive power limits"), where the unit has
// been, what was asked for.
#include <algorithm>
#include <cmath>

#include "services/cli/envelope_curves.hpp"
#include "services/cli/figure_script.hpp"

namespace weakgrid {

namespace {

constexpr FigureSize size{710, 560};

// Of what must be seen.
struct Box {
  double p_min = 0.0, p_max = 0.0, q_min = 0.0, q_max = 0.0;

  void include(double p, double q) {
    p_min = std::min(p_min, p);
    p_max = std::max(p_max, p);
    q_min = std::min(q_min, q);
    q_max = std::max(q_max, q);
  }
  // Equal axes in a square frame, with room.
  Box squared() const {
    const double half = std::max(0.1, 0.56 * std::max(p_max - p_min, q_max - q_min));
    const double p = 0.5 * (p_min + p_max), q = 0.5 * (q_min + q_max);
    return {p - half, p + half, q - half, q + half};
  }
  bool contains(double p, double q) const { return p >= p_min && p <= p_max && q >= q_min && q <= q_max; }
  double reach() const {
    return std::hypot(std::max(std::abs(p_min), std::abs(p_max)), std::max(std::abs(q_min), std::abs(q_max)));
  }
};

struct DrawnLimit {
  Limit limit;
  const char* name;
  std::string title, style;
};

std::vector<DrawnLimit> limits_of(const Settings& settings) {
  const auto& g = settings.gateway;
  return {{Limit::steady_state, "lambda", "{/:Italic λ} = 0", "lc rgb '#000000' lw 2"},
          {Limit::current, "current", fmt::format("|{{/:Italic i}}| = {:.3g}", g.current_max),
           "lc rgb '#0072b2' lw 1.7 dt (10,4)"},
          {Limit::control, "control", "|{/:Italic μ}| = 1/√2", "lc rgb '#d55e00' lw 1.7 dt (10,3,2,3)"},
          {Limit::pcc_voltage_min, "low", fmt::format("|{{/:Italic v_p}}| = {:.3g}", g.pcc_voltage_min),
           "lc rgb '#009e73' lw 1.9 dt (2,3)"},
          {Limit::pcc_voltage_max, "high", fmt::format("|{{/:Italic v_p}}| = {:.3g}", g.pcc_voltage_max),
           "lc rgb '#aa4499' lw 1.7 dt (5,3)"}};
}

class Plane {
 public:
  Plane(const PlotData& data, const FigureStyle& style) : data_(data), script_(style, size) {
    for (const PlotPoint& point : data.path.line()) box_.include(point.x, point.y);
    for (const PlotSetpoint& s : data.setpoints)
      if (std::hypot(s.setpoint.p, s.setpoint.q) < 10.0) box_.include(s.setpoint.p, s.setpoint.q);
  }

  std::string script() && {
    if (data_.gateway) add_envelope();
    const Box view = box_.squared();
    if (data_.gateway) add_limits(view);
    add_path();
    add_setpoints();
    frame(view);
    script_.line("plot {}", plot_);
    return std::move(script_).end();
  }

 private:
  void add(const std::string& curve) { plot_ += (plot_.empty() ? "" : ", \\\n  ") + curve; }

  EnvelopeSlice envelope() const {
    const Arbiter::Configuration gateway = arbiter_configuration(*data_.gateway);
    const GridBox& box = gateway.box;
    return {
        box, {box.R_g.low, box.L_g.high, box.V.low}, gateway.converter, gateway.limits, data_.standing_v_c};
  }

  void add_envelope() {
    const Limits limits = envelope().limits;
    const double reach = std::min(4.0, std::max(1.2 * limits.i_max * limits.v_p_max, box_.reach()));
    const auto areas = admissible_areas(envelope(), reach);
    for (std::size_t n = 0; n < areas.size(); ++n) {
      // There and back again, as one outline.
      PlotLine low, high;
      for (const AdmissibleSpan& span : areas[n]) {
        low.push_back({span.p, span.q_min});
        high.push_back({span.p, span.q_max});
        box_.include(span.p, span.q_min);
        box_.include(span.p, span.q_max);
      }
      PlotLine outline = simplified(low, 5e-4);
      const PlotLine back = simplified(high, 5e-4);
      outline.insert(outline.end(), back.rbegin(), back.rend());
      script_.data(fmt::format("area{}", n), {outline});
      add(fmt::format("$area{} with filledcurves closed fc rgb '#e6eef5' {}", n,
                      n == 0 ? "title 'admissible'" : "notitle"));
    }
  }

  void add_limits(const Box& view) {
    for (const DrawnLimit& limit : limits_of(*data_.gateway)) {
      std::vector<PlotLine> lines;
      bool is_seen = false;
      for (const auto& piece : limit_curve(envelope(), limit.limit, 1.2 * view.reach())) {
        PlotLine& line = lines.emplace_back();
        for (const Setpoint& s : piece) {
          line.push_back({s.p, s.q});
          is_seen = is_seen || view.contains(s.p, s.q);
        }
      }
      if (!is_seen) continue;
      script_.data(limit.name, lines);
      add(fmt::format("${} with lines {} title '{}'", limit.name, limit.style, limit.title));
    }
  }

  void add_path() {
    script_.data("path", {data_.path.line()});
    add("$path with lines lc rgb '#333333' lw 1.1 title 'measured'");
  }

  void add_setpoints() {
    std::vector<PlotLine> accepted, refused;
    for (const PlotSetpoint& s : data_.setpoints)
      (s.verdict == Verdict::accepted ? accepted : refused).push_back({{s.setpoint.p, s.setpoint.q}});
    if (!accepted.empty()) {
      script_.data("accepted", accepted);
      add("$accepted with points pt 7 ps 0.9 lc rgb '#e69f00' title 'accepted'");
      add("$accepted with points pt 6 ps 0.9 lw 1.2 lc rgb '#000000' notitle");
    }
    if (refused.empty()) return;
    script_.data("refused", refused);
    add("$refused with points pt 2 ps 1.1 lw 2.4 lc rgb '#d55e00' title 'refused'");
  }

  void frame(const Box& view) {
    script_.line("set xrange [{:.6g}:{:.6g}]\nset yrange [{:.6g}:{:.6g}]", view.p_min, view.p_max, view.q_min,
                 view.q_max);
    script_.line("set size ratio -1\nunset grid");
    script_.line(
        "set xzeroaxis lw 0.8 lc rgb '#999999' dt solid\nset yzeroaxis lw 0.8 lc rgb '#999999' dt solid");
    const double left = 70.0, top = 30.0, side = size.height - top - 54.0;
    const auto x = [](double at) { return at / size.width; };
    const auto y = [](double at) { return 1.0 - at / size.height; };
    script_.line("set lmargin at screen {:.4f}\nset rmargin at screen {:.4f}", x(left), x(left + side));
    script_.line("set tmargin at screen {:.4f}\nset bmargin at screen {:.4f}", y(top), y(top + side));
    script_.line("set xlabel 'active power {{/:Italic p}} (p.u.)' offset 0,0.3");
    script_.line("set ylabel 'reactive power {{/:Italic q}} (p.u.)' offset 0.6,0");
    script_.line(
        "set key at screen {:.4f}, screen {:.4f} left top vertical Left reverse samplen 2.6 maxrows 12",
        x(left + side + 4.0), y(top));
    if (data_.gateway)
      script_.line("set label 1 'limits at {{/:Italic v_c}} = {:.4g}' at screen {:.4f}, screen {:.4f} left",
                   data_.standing_v_c, x(left + side + 14.0), y(top + side - 8.0));
  }

  const PlotData& data_;
  FigureScript script_;
  Box box_;
  std::string plot_;
};

}  // namespace

std::string plane_script(const PlotData& data, const FigureStyle& style) {
  return Plane(data, style).script();
}

}  // namespace weakgrid

// Histograms of how long the loop takes: sample to sample, sample to answer, publication to recorder.
#include <algorithm>
#include <cmath>
#include <map>

#include "services/cli/figure_script.hpp"

namespace weakgrid {

namespace {

constexpr FigureSize size{620, 700};
constexpr int panels = 3;
constexpr double bars_per_decade = 24.0;

// Microseconds, four digits at most.
std::string microseconds(std::uint64_t ns) {
  const double us = static_cast<double>(ns) * 1e-3;
  return us < 1000.0 ? fmt::format("{:.3g}", us) : fmt::format("{:.0f}", us);
}

std::string summary(const DurationHistogram& h) {
  if (h.count() == 0) return "none recorded";
  return fmt::format("p50 {}   p99 {}   p99.9 {}   max {} µs", microseconds(h.quantile_ns(0.5)),
                     microseconds(h.quantile_ns(0.99)), microseconds(h.quantile_ns(0.999)),
                     microseconds(h.max_ns()));
}

// By the logarithm of the duration: number of the bar → how many.
std::map<long, std::uint64_t> bars_of(const DurationHistogram& h) {
  std::map<long, std::uint64_t> bars;
  h.each([&](double ns, std::uint64_t count) {
    bars[std::lround(std::floor(std::log10(std::max(ns, 1.0) * 1e-3) * bars_per_decade))] += count;
  });
  return bars;
}

double edge_us(long bar) { return std::pow(10.0, static_cast<double>(bar) / bars_per_decade); }

struct Panel {
  const char* caption;
  const DurationHistogram& histogram;
  const char* colour;
};

}  // namespace

std::string timing_script(const PlotData& data, const FigureStyle& style) {
  FigureScript script(style, size);
  const Panel drawn[panels] = {{"Sample to next sample", data.timings.interval, "#0072b2"},
                               {"Sample to answer", data.timings.turnaround, "#d55e00"},
                               {"Publication to recorder", data.timings.arrival, "#009e73"}};
  // One axis for all, whole decades.
  double low = 1e18, high = 1.0;
  for (const Panel& panel : drawn) {
    if (panel.histogram.count() == 0) continue;
    low = std::min(low, std::max(1.0, static_cast<double>(panel.histogram.min_ns())) * 1e-3);
    high = std::max(high, static_cast<double>(panel.histogram.max_ns()) * 1e-3);
  }
  low = std::pow(10.0, std::floor(std::log10(std::min(low, high))));
  high = std::pow(10.0, std::floor(std::log10(high)) + 1.0);
  script.line("set logscale xy\nset xrange [{:.3g}:{:.3g}]", low, high);
  script.line("set style fill solid 0.75 noborder\nset mxtics 10\nset mytics 1");
  for (int n = 0; n < panels; ++n) {
    const DurationHistogram& h = drawn[n].histogram;
    std::uint64_t most = 1;
    script.line("$bars{} << EOD", n);
    for (const auto& [bar, count] : bars_of(h)) {
      script.line("{:.6g} {:.6g} {}", edge_us(bar), edge_us(bar + 1), count);
      most = std::max(most, count);
    }
    script.line("{}EOD", h.count() == 0 ? "NaN NaN NaN\n" : "");
    script.panel(n, panels, drawn[n].caption, "count", summary(h));
    script.line("set yrange [0.5:{:.3g}]",
                2.0 * std::pow(10.0, std::ceil(std::log10(static_cast<double>(most)))));
    script.line("set format y '10^{{%L}}'");
    script.line("{}", n + 1 == panels ? "set format x '10^{%L}'\nset xlabel 'duration (µs)' offset 0,0.3"
                                      : "set format x ''\nunset xlabel");
    script.line("plot $bars{} using (sqrt($1*$2)):3:1:2:(0.5):3 with boxxyerror fc rgb '{}' notitle", n,
                drawn[n].colour);
  }
  return std::move(script).end();
}

}  // namespace weakgrid

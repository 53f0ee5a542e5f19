// What a figure needs of a signal of any length, in bounded memory: lines that keep every spike, and paths.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace weakgrid {

struct PlotPoint {
  double x = 0.0, y = 0.0;
  friend bool operator==(const PlotPoint&, const PlotPoint&) = default;
};
using PlotLine = std::vector<PlotPoint>;

/// A signal over steps: buckets of equal width, each with its minimum and maximum where they were; when there
/// are too many, neighbours are merged.
class ThinnedSeries {
 public:
  /// Two points a bucket at most.
  static constexpr std::size_t buckets_max = 1000;

  /// Steps rise; what does not, and what is not finite, is not taken.
  void add(std::uint64_t step, double t, double value) {
    if (!std::isfinite(value) || (!buckets_.empty() && step <= buckets_.back().last_step)) return;
    const Bucket one{step, step, {t, value}, {t, value}};
    if (!buckets_.empty() && index_of(buckets_.back()) == index_of(one))
      buckets_.back().merge(one);
    else
      buckets_.push_back(one);
    while (buckets_.size() > buckets_max) widen();
  }

  bool empty() const { return buckets_.empty(); }
  /// In steps, a power of two.
  std::uint64_t width() const { return width_; }

  /// Broken where steps are missing, a bucket's width of them or more.
  std::vector<PlotLine> lines() const {
    std::vector<PlotLine> lines;
    const Bucket* last = nullptr;
    for (const Bucket& bucket : buckets_) {
      if (last == nullptr || bucket.first_step - last->last_step > width_) lines.emplace_back();
      last = &bucket;
      const auto& [first, second] = std::minmax(
          bucket.low, bucket.high, [](const PlotPoint& a, const PlotPoint& b) { return a.x < b.x; });
      lines.back().push_back(first);
      if (second.x > first.x) lines.back().push_back(second);
    }
    return lines;
  }

 private:
  struct Bucket {
    std::uint64_t first_step, last_step;
    PlotPoint low, high;

    void merge(const Bucket& next) {
      last_step = next.last_step;
      if (next.low.y < low.y) low = next.low;
      if (next.high.y > high.y) high = next.high;
    }
  };

  std::uint64_t index_of(const Bucket& bucket) const { return bucket.first_step / width_; }

  void widen() {
    width_ *= 2;
    std::vector<Bucket> merged;
    for (const Bucket& bucket : buckets_) {
      if (!merged.empty() && index_of(merged.back()) == index_of(bucket))
        merged.back().merge(bucket);
      else
        merged.push_back(bucket);
    }
    buckets_ = std::move(merged);
  }

  std::vector<Bucket> buckets_;
  std::uint64_t width_ = 1;
};

/// Leaves out what lies within `tolerance` in y of the line between points that stay (Ramer, Douglas,
/// Peucker). x rises.
inline PlotLine simplified(const PlotLine& line, double tolerance) {
  if (line.size() < 3) return line;
  std::vector<bool> stays(line.size(), false);
  stays.front() = stays.back() = true;
  std::vector<std::pair<std::size_t, std::size_t>> stretches{{0, line.size() - 1}};
  while (!stretches.empty()) {
    const auto [from, to] = stretches.back();
    stretches.pop_back();
    const PlotPoint a = line[from], b = line[to];
    double worst = tolerance;
    std::size_t at = from;
    for (std::size_t n = from + 1; n < to; ++n) {
      const double y = a.y + (b.y - a.y) * ((line[n].x - a.x) / (b.x - a.x));
      if (const double distance = std::abs(line[n].y - y); distance > worst) {
        worst = distance;
        at = n;
      }
    }
    if (at == from) continue;
    stays[at] = true;
    stretches.emplace_back(from, at);
    stretches.emplace_back(at, to);
  }
  PlotLine out;
  for (std::size_t n = 0; n < line.size(); ++n)
    if (stays[n]) out.push_back(line[n]);
  return out;
}

/// Where a point has been in a plane: every one lies within tolerance() of a kept one.
class ThinnedPath {
 public:
  static constexpr std::size_t points_max = 4000;

  explicit ThinnedPath(double tolerance = 1e-3) : tolerance_(tolerance) {}

  void add(PlotPoint point) {
    if (!std::isfinite(point.x) || !std::isfinite(point.y)) return;
    last_ = point;
    keep(point);
    while (points_.size() > points_max) {
      tolerance_ *= 2.0;
      PlotLine before;
      before.swap(points_);
      for (const PlotPoint& kept : before) keep(kept, tolerance_ / 2.0);
    }
  }

  bool empty() const { return points_.empty(); }
  double tolerance() const { return tolerance_; }
  PlotLine line() const {
    PlotLine line = points_;
    if (!line.empty() && line.back() != last_) line.push_back(last_);
    return line;
  }

 private:
  void keep(PlotPoint point) { keep(point, tolerance_); }
  void keep(PlotPoint point, double spacing) {
    if (points_.empty() || std::hypot(point.x - points_.back().x, point.y - points_.back().y) > spacing)
      points_.push_back(point);
  }

  double tolerance_;
  PlotLine points_;
  PlotPoint last_;
};

}  // namespace weakgrid

// weakgrid plot: what thinning keeps, what the envelope's curves are, and figures of real recordings.
#include <cmath>
#include <cstdlib>
#include <sstream>

#include "services/cli/envelope_curves.hpp"
#include "services/recording/plot_data.hpp"
#include "services/runtime/payload.hpp"
#include "tests/recording/recording_support.hpp"
#include "tests/support/processes_under_test.hpp"

namespace weakgrid {
namespace {

using mcap::Folder;
using mcap::law_count;
using mcap::Random;

double uniform(Random& random, double low, double high) {
  return low + (high - low) * static_cast<double>(random() >> 11) * 0x1p-53;
}

TEST(Thinning, KeepsTheMinimumAndMaximumOfEachBucketWhateverItsWidth) {
  for (std::uint32_t seed = 1; seed <= law_count(30); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random{seed};
    ThinnedSeries series;
    std::map<std::uint64_t, double> all;
    std::uint64_t step = mcap::below(random, 1000);
    for (std::uint64_t n = mcap::below(random, 20'000) + 1; n > 0; --n) {
      const double value = mcap::below(random, 1000) == 0 ? 1e3 : uniform(random, -1.0, 1.0);
      series.add(step, static_cast<double>(step), value);
      all[step] = value;
      step += mcap::below(random, 200) == 0 ? mcap::below(random, 2000) + 1 : 1;
    }
    std::map<std::uint64_t, std::pair<double, double>> wanted, drawn;  // by bucket: minimum, maximum
    const auto note = [&series](auto& buckets, std::uint64_t at, double value) {
      auto& [low, high] = buckets.try_emplace(at / series.width(), value, value).first->second;
      low = std::min(low, value);
      high = std::max(high, value);
    };
    for (const auto& [at, value] : all) note(wanted, at, value);
    std::size_t points = 0;
    double last = -1.0;
    for (const PlotLine& line : series.lines())
      for (const PlotPoint& point : line) {
        ASSERT_GT(point.x, last);
        last = point.x;
        ASSERT_EQ(all.at(static_cast<std::uint64_t>(point.x)), point.y) << "a point that was there";
        note(drawn, static_cast<std::uint64_t>(point.x), point.y);
        ++points;
      }
    EXPECT_EQ(drawn, wanted);
    EXPECT_LE(points, 2 * ThinnedSeries::buckets_max);
  }
}

TEST(Thinning, BreaksTheLineWhereSamplesAreMissing) {
  ThinnedSeries series;
  for (std::uint64_t step = 0; step < 100; ++step)
    if (step != 40 && (step < 60 || step > 70)) series.add(step, static_cast<double>(step), 1.0);
  series.add(10, 10.0, 7.0);             // late
  series.add(200, 200.0, std::nan(""));  // no number
  const std::vector<PlotLine> lines = series.lines();
  ASSERT_EQ(lines.size(), 3u);
  EXPECT_EQ(lines[0].size(), 40u);
  EXPECT_EQ(lines[1].size(), 19u);
  EXPECT_EQ(lines[2].size(), 29u);
}

TEST(Thinning, ASimplifiedLineIsNowhereFartherThanTheTolerance) {
  for (std::uint32_t seed = 1; seed <= law_count(30); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random{seed};
    PlotLine line;
    double y = 0.0;
    for (int n = 0; n < 2000; ++n) line.push_back({n * 0.1, y += uniform(random, -0.1, 0.1)});
    const PlotLine kept = simplified(line, 0.25);
    EXPECT_LT(kept.size(), line.size());
    EXPECT_EQ(kept.front(), line.front());
    EXPECT_EQ(kept.back(), line.back());
    std::size_t at = 0;
    for (const PlotPoint& point : line) {
      while (at + 2 < kept.size() && kept[at + 1].x < point.x) ++at;
      const PlotPoint a = kept[at], b = kept[at + 1];
      ASSERT_LE(std::abs(point.y - (a.y + (b.y - a.y) * (point.x - a.x) / (b.x - a.x))), 0.25 + 1e-12);
    }
  }
}

TEST(Thinning, APathStaysWithinItsToleranceHoweverLongItIs) {
  Random random{3};
  ThinnedPath path(1e-3);
  PlotLine all;
  for (int n = 0; n < 100'000; ++n) {
    all.push_back({uniform(random, -1.0, 1.0), uniform(random, -1.0, 1.0)});
    path.add(all.back());
  }
  const PlotLine line = path.line();
  EXPECT_LE(line.size(), ThinnedPath::points_max + 1);
  EXPECT_EQ(line.back(), all.back());
}

TEST(Durations, QuantilesAreExactToHalfAPercentAndTheLongestExactly) {
  for (std::uint32_t seed = 1; seed <= law_count(30); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random{seed};
    DurationHistogram histogram;
    std::vector<std::uint64_t> all;
    for (int n = 0; n < 5000; ++n) {
      all.push_back(static_cast<std::uint64_t>(std::pow(10.0, uniform(random, 0.0, 12.0))));
      histogram.add(static_cast<std::int64_t>(all.back()));
    }
    std::sort(all.begin(), all.end());
    for (const double share : {0.5, 0.99, 0.999}) {
      const auto exact = static_cast<double>(all[static_cast<std::size_t>(share * 5000.0) - 1]);
      EXPECT_GE(static_cast<double>(histogram.quantile_ns(share)), exact);
      EXPECT_LE(static_cast<double>(histogram.quantile_ns(share)), exact * 1.005);
    }
    EXPECT_EQ(histogram.max_ns(), all.back());
    EXPECT_EQ(histogram.quantile_ns(1.0), all.back());
    std::uint64_t sum = 0;
    histogram.each([&sum](double, std::uint64_t count) { sum += count; });
    EXPECT_EQ(sum, 5000u);
  }
  DurationHistogram widest;
  widest.add(std::numeric_limits<std::int64_t>::max());
  widest.add(-1);
  EXPECT_EQ(widest.count(), 1u);
  EXPECT_EQ(widest.negative(), 1u);
}

// The curves come from the current plane, the margins from λ: two ways.
TEST(Envelope, EachCurveIsWhereTheMarginOfItsLimitIsZero) {
  for (std::uint32_t seed = 1; seed <= law_count(200); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random{seed};
    EnvelopeSlice envelope{
        .box = {}, .grid = {}, .converter = {}, .limits = {}, .v_c = uniform(random, 1.5, 2.4)};
    envelope.grid.V = uniform(random, 0.8, 1.1);
    if (seed % 4 != 0) envelope.grid.L_g = uniform(random, 0.0, 0.6) / envelope.converter.omega;
    if (seed % 4 > 1) envelope.grid.R_g = uniform(random, 0.0, 0.6);
    for (const Limit limit : {Limit::steady_state, Limit::current, Limit::control, Limit::control_rough,
                              Limit::pcc_voltage_min, Limit::pcc_voltage_max})
      for (const auto& piece : limit_curve(envelope, limit, 3.0))
        for (const Setpoint& s : piece) {
          const Assessment found = assess(envelope.grid, envelope.converter, envelope.limits, s);
          const LimitMargin* margin = found.margins.find(limit);
          // Where λ = 0 too, rounding decides whether there is a steady state.
          const double zero =
              margin != nullptr ? margin->margin : found.margins.find(Limit::steady_state)->margin;
          ASSERT_NEAR(zero, 0.0, 1e-7) << s.p << " + j" << s.q;
        }
  }
}

TEST(Envelope, AtThePapersWeakGridTheCurvesPassThroughItsNumbers) {
  const Converter converter;
  const EnvelopeSlice envelope{.box = box_of({0.0, 0.3 / converter.omega, 1.0}),
                               .grid = {0.0, 0.3 / converter.omega, 1.0},
                               .converter = converter,
                               .limits = {},
                               .v_c = 1.3 * std::sqrt(2.0)};
  const auto q_at = [&](Limit limit, double near_q) {
    double q = HUGE_VAL, distance = 0.05;
    for (const auto& piece : limit_curve(envelope, limit, 2.0))
      for (const Setpoint& s : piece)
        if (std::hypot(s.p - 0.707, s.q - near_q) < distance) {
          distance = std::hypot(s.p - 0.707, s.q - near_q);
          q = s.q;
        }
    return q;
  };
  EXPECT_NEAR(q_at(Limit::steady_state, -0.683379), -0.683379, 0.01);
  EXPECT_NEAR(q_at(Limit::current, -0.407214), -0.407214, 0.01);
  EXPECT_NEAR(q_at(Limit::current, 1.007214), 1.007214, 0.01);
  EXPECT_NEAR(q_at(Limit::control_rough, 1.358064), 1.358064, 0.01);
}

TEST(Envelope, WhatIsShadedIsAdmissibleAndNothingElse) {
  for (std::uint32_t seed = 1; seed <= law_count(10); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random{seed};
    EnvelopeSlice envelope{.box = {}, .grid = {}, .converter = {}, .limits = {}, .v_c = 1.3 * std::sqrt(2.0)};
    envelope.grid.L_g = uniform(random, 0.0, 0.8) / envelope.converter.omega;
    envelope.grid.R_g = uniform(random, 0.0, 0.8);
    envelope.box = box_of(envelope.grid);
    std::map<double, std::vector<AdmissibleSpan>> columns;
    for (const auto& area : admissible_areas(envelope, 1.5))
      for (const AdmissibleSpan& span : area) columns[span.p].push_back(span);
    ASSERT_FALSE(columns.empty());
    for (int n = 0; n < 5000; ++n) {
      auto column = columns.begin();
      std::advance(column, static_cast<long>(mcap::below(random, columns.size())));
      const double q = uniform(random, -1.5, 1.5);
      const bool is_shaded =
          std::any_of(column->second.begin(), column->second.end(),
                      [q](const AdmissibleSpan& s) { return q >= s.q_min && q <= s.q_max; });
      ASSERT_EQ(is_shaded,
                assess(envelope.grid, envelope.converter, envelope.limits, {column->first, q, envelope.v_c})
                    .admissible)
          << column->first << " + j" << q;
    }
  }
}

const char* const scenario =
    "[grid]\nreactance = 0.3\n[scenario]\ntitle = \"it's 'a title'\"\nend_s = 0.3\n"
    "[[scenario.setpoint]]\nat_s = 0.01\nactive_power = 0.5\n"
    "[[scenario.setpoint]]\nat_s = 0.1\nreactive_power = -2.0\n"
    "[[scenario.event]]\nat_s = 0.2\nquantity = \"grid_reactance\"\nvalue = 0.25\n";

std::string text_of(const std::string& file) {
  std::ostringstream text;
  text << std::ifstream(file, std::ios::binary).rdbuf();
  return text.str();
}

test::Ended plot(const std::vector<std::string>& arguments) {
  std::vector<std::string> all{"plot"};
  all.insert(all.end(), arguments.begin(), arguments.end());
  return test::run("weakgrid", all);
}

// One recording for all; plotting needs no DDS.
class Plot : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new Folder;
    const test::Domain domain;
    const test::TextFile file(scenario);
    const test::Ended run = test::run(
        "weakgrid", {"run", file.path(), "--domain", domain.text(), "--record", *folder_ / "run.mcap"});
    ASSERT_EQ(run.status, 1) << "a setpoint is refused" << run.out << run.err;
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static std::string path(const char* name) { return *folder_ / name; }

  /// The recording without the samples of steps [from, to).
  static std::string without_samples(const char* name, std::uint64_t from, std::uint64_t to) {
    mcap::Reader reader;
    mcap::Writer writer;
    EXPECT_TRUE(reader.open(path("run.mcap")).ok());
    EXPECT_TRUE(writer.open(path(name), mcap::small_chunks()).ok());
    std::map<mcap::ChannelId, mcap::ChannelId> channels;
    while (const auto record = reader.next()) {
      if (const auto* metadata = std::get_if<mcap::Metadata>(&*record)) {
        EXPECT_TRUE(writer.write_metadata(metadata->name, metadata->entries).ok());
      }
      const auto* message = std::get_if<mcap::Message>(&*record);
      if (message == nullptr) continue;
      const mcap::Channel& channel = reader.channels().at(message->channel_id);
      const mcap::Schema& schema = reader.schemas().at(channel.schema_id);
      const auto m = from_payload<Measurement>(message->data);
      if (schema.name == "weakgrid::wire::Measurement" && m && m->message.step >= from &&
          m->message.step < to)
        continue;
      auto& id = channels[message->channel_id];
      if (id == 0)
        id = writer.add_channel(
            writer.add_schema(
                schema.name, schema.encoding,
                std::string(reinterpret_cast<const char*>(schema.data.data()), schema.data.size())),
            channel.topic, channel.message_encoding, channel.metadata);
      EXPECT_TRUE(writer
                      .write_message(id, message->sequence, message->log_time_ns, message->publish_time_ns,
                                     message->data)
                      .ok());
    }
    EXPECT_TRUE(writer.close().ok());
    return path(name);
  }

 private:
  static Folder* folder_;
};
Folder* Plot::folder_ = nullptr;

TEST_F(Plot, DrawsEachFigureInEachFormat) {
  const std::map<std::string, std::vector<std::string>> words{
      {"panels",
       {"PCC voltage", "Injected current", "Reference power", "Scaled DC voltage", "p.u.", "time (s)",
        "it's 'a title'", "0.25"}},
      {"plane",
       {"active power", "reactive power", "(p.u.)", "admissible", "measured", "accepted", "refused"}},
      {"timing",
       {"Sample to next sample", "Sample to answer", "Publication to recorder", "duration (µs)", "count",
        "p50", "p99.9", "max"}}};
  for (const auto& [figure, wanted] : words) {
    SCOPED_TRACE(figure);
    for (const char* name : {"a.svg", "a.png", "a.pdf"}) {
      const test::Ended ended = plot({path("run.mcap"), "-o", path(name), "--figure", figure});
      ASSERT_EQ(ended.status, 0) << ended.err;
      EXPECT_EQ(ended.err, "") << "gnuplot has nothing to say";
    }
    const std::string svg = text_of(path("a.svg"));
    EXPECT_TRUE(svg.find("<svg") != std::string::npos && svg.find("</svg>") != std::string::npos);
    for (const std::string& word : wanted) EXPECT_NE(svg.find(word), std::string::npos) << word;
    EXPECT_LT(svg.size(), 150'000u);
    EXPECT_EQ(text_of(path("a.png")).substr(0, 8), "\x89PNG\r\n\x1a\n");
    EXPECT_GT(text_of(path("a.png")).size(), 10'000u);
    EXPECT_EQ(text_of(path("a.pdf")).substr(0, 5), "%PDF-");
  }
}

TEST_F(Plot, ShowsWhatControllersDoNotPublishAsTheyHadIt) {
  const PlotData data = plot_data({.files = {path("run.mcap")}, .unit = {}});
  EXPECT_GE(data.samples, 2990u);
  EXPECT_EQ(data.samples == 3000, data.incomplete.empty());
  EXPECT_EQ(data.p_r.lines().size(), 1u);
  const auto settled = [](const ThinnedSeries& series) { return series.lines().back().back().y; };
  EXPECT_NEAR(settled(data.p), 0.5, 1e-3);
  EXPECT_NEAR(settled(data.p_r), 0.5, 1e-3);
  EXPECT_NEAR(settled(data.q_r), 0.0, 1e-12) << "the other setpoint was refused";
  EXPECT_NEAR(settled(data.v_p_hat.magnitude), settled(data.v_p.magnitude), 1e-3);
  ASSERT_EQ(data.setpoints.size(), 2u);
  EXPECT_EQ(data.setpoints[0].verdict, Verdict::accepted);
  EXPECT_EQ(data.setpoints[1].verdict, Verdict::outside_envelope);
  ASSERT_EQ(data.marks.size(), 1u);
  EXPECT_EQ(data.marks[0].text, "X_g → 0.25");
  // Loop messages are best effort: on a busy machine the recorder may miss one that the plant had.
  EXPECT_GE(data.timings.interval.count(), 2990u);
  EXPECT_GE(data.timings.turnaround.count(), 2990u);
}

TEST_F(Plot, LeavesAGapWhereSamplesAreLostAndSaysSo) {
  const std::string file = without_samples("lost.mcap", 1200, 1300);
  const test::Ended ended = plot({file, "-o", path("lost.svg")});
  EXPECT_EQ(ended.status, 1);
  EXPECT_NE(ended.err.find("100 samples are not in the recording"), std::string::npos) << ended.err;
  EXPECT_NE(text_of(path("lost.svg")).find("lost"), std::string::npos);
  const PlotData data = plot_data({.files = {file}, .unit = {}});
  EXPECT_EQ(data.p.lines().size(), 2u);
  ASSERT_EQ(data.losses.size(), 1u);
  EXPECT_NEAR(data.losses[0].from_s, 0.12, 1e-9);
}

TEST_F(Plot, TakesAPartOfTheTime) {
  const PlotData data = plot_data({.files = {path("run.mcap")}, .unit = {}, .from_s = 0.1, .until_s = 0.15});
  EXPECT_EQ(data.samples, 501u);
  EXPECT_EQ(data.v_p_hat.alpha.lines().front().front().x, data.v_p.alpha.lines().front().front().x);
  EXPECT_EQ(plot({path("run.mcap"), "-o", path("part.svg"), "--from", "0.1", "--until", "0.15"}).status, 0);
}

TEST_F(Plot, RefusesWhatItCannotDrawAndLeavesNothingBehind) {
  const std::string run = path("run.mcap");
  mcap::write_bytes(path("text.mcap"), mcap::bytes_of("not a recording at all"));
  const struct {
    std::vector<std::string> arguments;
    int status;
    const char* reason;
  } cases[] = {
      {{path("missing.mcap"), "-o", path("x.svg")}, 2, "missing.mcap"},
      {{path("text.mcap"), "-o", path("x.svg")}, 2, "text.mcap"},
      {{run, "-o", path("x.jpg")}, 2, "allowed: .svg, .png or .pdf"},
      {{run, "-o", path("x.svg"), "--unit", "7"}, 2, "unit 7: not in the recording; there is: 1"},
      {{run, "-o", path("x.svg"), "--from", "5"}, 2, "nothing to plot"},
      {{run, "-o", path("x.svg"), "--from", "0.2", "--until", "0.1"}, 2, "--until"},
      {{run, "-o", path("x.svg"), "--figure", "cake"}, 2, "cake"},
      {{run, "-o", path("no_folder/x.svg")}, 3, "cannot be written"},
      {{run}, 2, "--output"},
  };
  for (const auto& [arguments, status, reason] : cases) {
    const test::Ended ended = plot(arguments);
    EXPECT_EQ(ended.status, status) << reason;
    EXPECT_NE(ended.err.find(reason), std::string::npos) << ended.err;
  }
  for (const auto& entry : std::filesystem::directory_iterator(std::filesystem::path(run).parent_path()))
    EXPECT_NE(entry.path().filename().string().front(), 'x') << entry.path();
}

TEST_F(Plot, SaysThatGnuplotIsMissingAndKeepsTheFigureThatWasThere) {
  mcap::write_bytes(path("kept.svg"), mcap::bytes_of("before"));
  const std::string search = std::getenv("PATH");
  setenv("PATH", path("").c_str(), 1);
  const test::Ended ended = plot({path("run.mcap"), "-o", path("kept.svg")});
  setenv("PATH", search.c_str(), 1);
  EXPECT_EQ(ended.status, 3);
  EXPECT_NE(ended.err.find("gnuplot is missing: apt-get install gnuplot-nox"), std::string::npos)
      << ended.err;
  EXPECT_EQ(text_of(path("kept.svg")), "before");
  EXPECT_EQ(plot({path("run.mcap"), "-o", path("kept.svg")}).status, 0);
  EXPECT_NE(text_of(path("kept.svg")), "before") << "a figure is replaced";
}

}  // namespace
}  // namespace weakgrid

// weakgrid plot: a figure of a recording.
#include <fmt/format.h>

#include <map>

#include "services/cli/commands.hpp"
#include "services/cli/figure.hpp"
#include "services/runtime/program.hpp"

namespace weakgrid {

namespace {

struct Options {
  PlotSelection selection;
  std::string output;
  std::string figure = "panels";
  std::optional<std::string> title;
};

using Draw = std::string (*)(const PlotData&, const FigureStyle&);
const std::map<std::string, Draw> figures{
    {"panels", panels_script}, {"plane", plane_script}, {"timing", timing_script}};

int plot(Options options) {
  const auto format = figure_format(options.output);
  if (!format) throw SettingsError(options.output + ": not a figure; allowed: .svg, .png or .pdf");
  if (!(options.selection.until_s > options.selection.from_s))
    throw SettingsError("--until: must be above --from");
  options.selection.reexecutes = options.figure == "panels";
  PlotData data = plot_data(options.selection);
  if (options.figure == "plane" && !data.gateway)
    data.incomplete.push_back("no gateway has said its settings: the envelope is not known");
  draw_figure(figures.at(options.figure)(data, {*format, options.title.value_or(data.title)}),
              options.output);
  for (const std::string& what : data.incomplete) fmt::print(stderr, "weakgrid: {}\n", what);
  return data.incomplete.empty() ? exit_done : exit_no;
}

}  // namespace

Command add_plot(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("plot", "Draws a figure of a recording, with gnuplot.");
  command->add_option("RECORDING", options->selection.files, "MCAP file, or the parts of one in order")
      ->required();
  command->add_option("-o,--output", options->output, "FILE.svg, .png or .pdf; what is there is replaced")
      ->required();
  command
      ->add_option("--figure", options->figure,
                   "panels: voltages, current, powers over time; plane: powers in the envelope; "
                   "timing: histograms")
      ->check(CLI::IsMember({"panels", "plane", "timing"}))
      ->capture_default_str();
  command->add_option("--from", options->selection.from_s, "in s of the unit's time, step × period");
  command->add_option("--until", options->selection.until_s, "likewise (default: to the end)");
  command->add_option("--unit", options->selection.unit, "unit number (default: the only one)")
      ->check(CLI::Range(1u, 4294967295u));
  command->add_option("--title", options->title, "above the figure (default: the scenario's; \"\" for none)");
  command->footer(
      "Example: weakgrid plot run.mcap -o run.svg\n"
      "Exit: 0 done, 1 drawn, but something is missing: see stderr, 2 not a recording or nothing to plot, "
      "3 the world failed.");
  return [options] { return plot(*options); };
}

}  // namespace weakgrid

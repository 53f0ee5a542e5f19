// Figures of a recording as gnuplot scripts with their data in them, and gnuplot itself.
#pragma once

#include <optional>
#include <string>

#include "services/recording/plot_data.hpp"

namespace weakgrid {

enum class FigureFormat : std::uint8_t { svg, png, pdf };

/// By the end of the name; nothing for any other.
std::optional<FigureFormat> figure_format(const std::string& file);

struct FigureStyle {
  FigureFormat format = FigureFormat::svg;
  std::string title;  ///< empty: none
};

/// The paper's four panels over time.
std::string panels_script(const PlotData& data, const FigureStyle& style);
/// The p-q plane: envelope, trajectory, setpoints.
std::string plane_script(const PlotData& data, const FigureStyle& style);
/// Histograms of how long the loop takes.
std::string timing_script(const PlotData& data, const FigureStyle& style);

/// Runs gnuplot on the script and puts the picture at `file`, whole or not at all; what was there is
/// replaced. Throws std::runtime_error.
void draw_figure(const std::string& script, const std::string& file);

}  // namespace weakgrid

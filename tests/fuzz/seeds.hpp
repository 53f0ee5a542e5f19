// Small good inputs of every kind, to begin mutations from.
#pragma once

#include <string>
#include <vector>

#include "services/recording/mcap_format.hpp"

namespace weakgrid::fuzz {

/// One of every message that travels, with all its sequences and texts filled.
std::vector<mcap::Bytes> payload_seeds();
/// Recordings of those in each compression, with metadata and an attachment, of several chunks. `folder` is
/// where they are written meanwhile.
std::vector<mcap::Bytes> recording_seeds(const std::string& folder);
std::vector<std::string> settings_seeds();
/// Tables.
std::vector<std::string> schedule_seeds();
/// Journals of one entry and of several.
std::vector<std::string> journal_seeds();

}  // namespace weakgrid::fuzz

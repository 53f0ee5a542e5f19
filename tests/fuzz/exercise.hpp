// Everything that bytes of strangers reach, each with the claims that hold whatever the bytes are. A claim
// that fails throws std::logic_error, which a fuzzer and a test see alike.
#pragma once

#include <string>
#include <string_view>

#include "services/recording/mcap_format.hpp"

namespace weakgrid::fuzz {

/// Both readers, with and without regard to CRCs.
void exercise_reader(mcap::ByteView bytes);
/// The same with a summary whose CRC holds, if the last bytes can be taken for a footer: a fuzzer finds no
/// CRC.
void exercise_summary(mcap::ByteView bytes);
/// recover() and export, on files in `folder`, which holds nothing else and is left empty.
void exercise_recover(mcap::ByteView bytes, const std::string& folder);
/// As each type of message.
void exercise_payload(mcap::ByteView payload);
void exercise_settings(std::string_view text);
/// As the table of a schedule; as a settings file it is one of those.
void exercise_schedule(std::string_view text);
/// As a journal, in one piece and byte by byte; and each line as one of its own.
void exercise_journal(std::string_view text);

}  // namespace weakgrid::fuzz

// A decision in words, for decision messages, logs and terminals.
#pragma once

#include <string>

#include "gateway/arbiter.hpp"

namespace weakgrid {

const char* name(Limit limit);
const char* name(Verdict verdict);
const char* name(RequestKind kind);
const char* name(Source source);
/// Name and source.
std::string text_of(const Holder& holder);
/// One line: accepted with ramp and start, or every reason against it.
std::string describe(const Decision& decision, const Timing& timing);

}  // namespace weakgrid

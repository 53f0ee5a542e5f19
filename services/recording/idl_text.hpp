// The wire contract as text, as recordings carry it.
#pragma once

#include <string_view>

namespace weakgrid {

/// idl/weakgrid.idl as it was when this program was built.
std::string_view idl_text();

}  // namespace weakgrid

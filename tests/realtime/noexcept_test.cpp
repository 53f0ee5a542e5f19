// What runs in a step never throws, and what passes between the rooms is plain memory: checked when it
// compiles.
#include <cstdint>
#include <optional>
#include <type_traits>
#include <utility>

#include "controller/controller.hpp"
#include "gateway/arbiter.hpp"
#include "plant/emulator.hpp"

namespace weakgrid {
namespace {

template <typename T>
T& some() noexcept;

static_assert(noexcept(some<Controller>().step(some<const Measurement>())));
static_assert(noexcept(some<Controller>().accept(some<const Reference>())));
static_assert(noexcept(some<Controller>().reset()));
static_assert(noexcept(some<Controller>().restore(some<const Controller>().state())));
static_assert(noexcept(some<ReferenceShaper>().accept(some<const Reference>())));
static_assert(noexcept(some<ReferenceShaper>().advance_to(0, false)));
static_assert(noexcept(some<const ReferenceShaper>().at(0)));

static_assert(noexcept(some<const Emulator>().sample()));
static_assert(noexcept(some<Emulator>().advance(std::optional<SpaceVector>{})));
static_assert(noexcept(some<Emulator>().accept(some<const Reference>())));
static_assert(noexcept(some<Emulator>().reset_trip()));
static_assert(noexcept(some<Emulator>().trip(Trip::overrun)));
static_assert(noexcept(some<Plant>().advance(SpaceVector{}, 0.0, some<const Grid>())));
static_assert(noexcept(some<Plant>().advance_blocked(some<const Grid>())));
static_assert(noexcept(some<Plant>().restart(0.0, some<const Grid>())));
static_assert(noexcept(some<Surroundings>().advance_to(0)));
static_assert(noexcept(some<Surroundings>().dispatch(0.0, 0, 0)));
static_assert(noexcept(some<Surroundings>().open_source()));
static_assert(noexcept(check(some<const Protection>(), SpaceVector{}, 0.0)));

static_assert(noexcept(some<Arbiter>().decide(some<const Request>(), 0)));
static_assert(noexcept(some<Arbiter>().block()));
static_assert(noexcept(assess(some<const Grid>(), some<const Converter>(), some<const Limits>(),
                              some<const Setpoint>())));

static_assert(std::is_trivially_copyable_v<Measurement>);
static_assert(std::is_trivially_copyable_v<Modulation>);
static_assert(std::is_trivially_copyable_v<Reference>);
static_assert(std::is_trivially_copyable_v<Decision>);
static_assert(std::is_trivially_copyable_v<Controller>);
static_assert(std::is_trivially_copyable_v<Emulator>);

}  // namespace
}  // namespace weakgrid

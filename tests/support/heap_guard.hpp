// Counts what a thread takes from the heap: "no heap on the hot path" as a test. For glibc, or a sanitizer's
// heap.
#pragma once

#include <cstdint>

namespace weakgrid::test {

/// While it lives, counts malloc, calloc, realloc, aligned allocation and operator new of the thread that
/// made it. One at a time per thread. GoogleTest's assertions allocate: judge after its end.
class HeapGuard {
 public:
  HeapGuard() noexcept;
  ~HeapGuard();
  HeapGuard(const HeapGuard&) = delete;
  HeapGuard& operator=(const HeapGuard&) = delete;

  /// So far.
  std::uint64_t allocations() const noexcept;
};

}  // namespace weakgrid::test

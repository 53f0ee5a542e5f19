// HeapGuard: malloc & co. interposed and passed on to glibc's, or the hook of the sanitizer that owns the
// heap. operator new needs nothing of its own: it calls malloc or aligned_alloc.
#include "tests/support/heap_guard.hpp"

#include <cerrno>
#include <cstddef>
#include <cstdlib>

namespace weakgrid::test {
namespace {

thread_local constinit bool armed = false;
thread_local constinit std::uint64_t counted = 0;

void note_allocation() noexcept {
  if (armed) ++counted;
}

}  // namespace

HeapGuard::HeapGuard() noexcept {
  counted = 0;
  armed = true;
}
HeapGuard::~HeapGuard() { armed = false; }
std::uint64_t HeapGuard::allocations() const noexcept { return counted; }

}  // namespace weakgrid::test

using weakgrid::test::note_allocation;

// NOLINTBEGIN(bugprone-reserved-identifier,cert-dcl37-c,cert-dcl51-cpp): the names are glibc's and the
// sanitizers'.
#ifdef WEAKGRID_SANITIZED

extern "C" void __sanitizer_malloc_hook(const volatile void*, std::size_t) { note_allocation(); }

#else

extern "C" {
void* __libc_malloc(std::size_t) noexcept;
void* __libc_calloc(std::size_t, std::size_t) noexcept;
void* __libc_realloc(void*, std::size_t) noexcept;
void* __libc_memalign(std::size_t, std::size_t) noexcept;

void* malloc(std::size_t size) noexcept {
  note_allocation();
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) noexcept {
  note_allocation();
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) noexcept {
  note_allocation();
  return __libc_realloc(memory, size);
}
void* memalign(std::size_t alignment, std::size_t size) noexcept {
  note_allocation();
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) noexcept {
  note_allocation();
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** memory, std::size_t alignment, std::size_t size) noexcept {
  note_allocation();
  if (alignment < sizeof(void*) || (alignment & (alignment - 1)) != 0) return EINVAL;
  void* const taken = __libc_memalign(alignment, size);
  if (taken == nullptr) return ENOMEM;
  *memory = taken;
  return 0;
}
}

#endif
// NOLINTEND(bugprone-reserved-identifier,cert-dcl37-c,cert-dcl51-cpp)

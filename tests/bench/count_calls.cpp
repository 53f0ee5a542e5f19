// To be preloaded: counts what each thread takes from the heap and which mutexes it locks, of these apart
// those that the program's own code locks and not a library's. Says it at the end. For glibc.
#include <link.h>
#include <pthread.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstdio>

namespace {

struct Thread {
  std::atomic<long> id{0};
  std::atomic<std::uint64_t> allocations{0}, locks{0}, own_locks{0};
};
// The last one is that of all threads beyond.
Thread threads[256];
std::atomic<unsigned> known{0};
thread_local constinit Thread* own = nullptr;

std::atomic<std::uintptr_t> text_begin{0}, text_end{0};

Thread& self() noexcept {
  if (own == nullptr) {
    const unsigned n = known.fetch_add(1);
    own = &threads[n < 255 ? n : 255];
    own->id = syscall(SYS_gettid);
  }
  return *own;
}

void note() noexcept { self().allocations.fetch_add(1, std::memory_order_relaxed); }

// The first object is the program itself.
[[gnu::constructor]] void find_program() {
  dl_iterate_phdr(
      [](dl_phdr_info* object, std::size_t, void*) {
        for (int n = 0; n < object->dlpi_phnum; ++n) {
          const auto& part = object->dlpi_phdr[n];
          if (part.p_type != PT_LOAD || (part.p_flags & PF_X) == 0) continue;
          text_begin = object->dlpi_addr + part.p_vaddr;
          text_end = text_begin + part.p_memsz;
        }
        return 1;
      },
      nullptr);
}

[[gnu::destructor]] void say() {
  for (const Thread& thread : threads)
    if (thread.id != 0)
      dprintf(STDERR_FILENO, "calls: thread %ld allocations %llu locks %llu own %llu\n", thread.id.load(),
              static_cast<unsigned long long>(thread.allocations.load()),
              static_cast<unsigned long long>(thread.locks.load()),
              static_cast<unsigned long long>(thread.own_locks.load()));
}

}  // namespace

extern "C" {

void* __libc_malloc(std::size_t) noexcept;
void* __libc_calloc(std::size_t, std::size_t) noexcept;
void* __libc_realloc(void*, std::size_t) noexcept;
void* __libc_memalign(std::size_t, std::size_t) noexcept;

void* malloc(std::size_t size) noexcept {
  note();
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) noexcept {
  note();
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) noexcept {
  note();
  return __libc_realloc(memory, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) noexcept {
  note();
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** memory, std::size_t alignment, std::size_t size) noexcept {
  note();
  *memory = __libc_memalign(alignment, size);
  return *memory != nullptr ? 0 : 12;  // ENOMEM
}

int __pthread_mutex_lock(pthread_mutex_t*) noexcept;

int pthread_mutex_lock(pthread_mutex_t* mutex) noexcept {
  Thread& thread = self();
  thread.locks.fetch_add(1, std::memory_order_relaxed);
  const auto from = reinterpret_cast<std::uintptr_t>(__builtin_return_address(0));
  if (from >= text_begin && from < text_end) thread.own_locks.fetch_add(1, std::memory_order_relaxed);
  return __pthread_mutex_lock(mutex);
}

}  // extern "C"

/* Arrays at the start of a cache line, and a heap in large pages.
 *
 * gfortran's allocate takes what malloc gives, and glibc gives 16 mod 64 to any large
 * array: then every 512-bit load or store touches two cache lines, which costs the force
 * kernel a third of its speed (docs/performance.md). The standard has no word for
 * alignment, so malloc itself hands out whole lines from a kilobyte on; everything else
 * is glibc's own. On other C libraries nothing is changed.
 *
 * What it could not give is noted: a program that then ends, however that looks, is out of
 * memory (castnet_process_guard.c). */
#define _DEFAULT_SOURCE
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>
#if defined(__GLIBC__)
#include <malloc.h>
#endif

volatile size_t castnet_refused_bytes = 0; /* that were last asked for in vain; 0: never */

/* It was told and dealt with: what ends later has another reason. */
void castnet_forget_refusal(void) { castnet_refused_bytes = 0; }

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) /* the sanitizer has its own */

extern void *__libc_malloc(size_t size);
extern void *__libc_memalign(size_t alignment, size_t size);
extern void *__libc_realloc(void *old, size_t size);
extern void *__libc_calloc(size_t n, size_t size);

void *malloc(size_t size) {
  void *room = size < 1024 ? __libc_malloc(size) : __libc_memalign(64, size);
  if (room == NULL) castnet_refused_bytes = size;
  return room;
}

void *realloc(void *old, size_t size) {
  void *room = __libc_realloc(old, size);
  if (room == NULL && size > 0) castnet_refused_bytes = size;
  return room;
}

void *calloc(size_t n, size_t size) {
  void *room = __libc_calloc(n, size);
  if (room == NULL) castnet_refused_bytes = n * size;
  return room;
}

/* Have the heap grow in large pages, where the system gives them to who asks. A run touches a
 * thousand pages of 4 KiB; the system takes 1.6 us for each at its first touch (on a virtual
 * machine), 100 us for one of 2 MiB. What lies before the first large page is set aside and
 * never touched. Blocks from four megabytes on still come and go by themselves. */
void castnet_use_large_pages(void) {
  static void *aside; /* to be found by tools that look for lost blocks */
  const uintptr_t large = (uintptr_t)1 << 21;
  const size_t probe = (size_t)1 << 18;
  if (aside != NULL || mallopt(M_TOP_PAD, 8 << 21) == 0) return;
  (void)mallopt(M_MMAP_THRESHOLD, 4 << 20);
  (void)mallopt(M_TRIM_THRESHOLD, 16 << 21);
  void *first = __libc_malloc(probe);
  uintptr_t begin = (uintptr_t)first, end = (uintptr_t)sbrk(0);
  free(first);
  (void)mallopt(M_TOP_PAD, 1 << 21);
  if (begin == 0 || end < begin + probe || end - begin > 16 * large) return; /* not of the growing heap */
  uintptr_t page = (begin + large - 1) & ~(large - 1);
  end &= ~(large - 1);
  if (page >= end) return;
  if (page > begin + 64) aside = __libc_malloc(page - begin - 32);
#ifdef MADV_HUGEPAGE
  (void)madvise((void *)page, end - page, MADV_HUGEPAGE);
#endif
}

#else

void castnet_use_large_pages(void) {}

#endif

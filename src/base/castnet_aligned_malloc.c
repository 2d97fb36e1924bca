/* Arrays at the start of a cache line.
 *
 * gfortran's allocate takes what malloc gives, and glibc gives 16 mod 64 to any large
 * array: then every 512-bit load or store touches two cache lines, which costs the force
 * kernel a third of its speed (docs/performance.md). The standard has no word for
 * alignment, so malloc itself hands out whole lines from a kilobyte on; everything else
 * is glibc's own. On other C libraries nothing is changed.
 *
 * What it could not give is noted: a program that then ends, however that looks, is out of
 * memory (castnet_process_guard.c). */
#include <stdlib.h>

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

#endif

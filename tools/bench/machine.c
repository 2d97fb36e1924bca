/* What this core can do: the ceilings of the roofline (roofline.py), one line each.
 *
 *   cc -O3 -march=native -ffp-contract=off -fno-math-errno -fno-trapping-math -mprefer-vector-width=512 machine.c -lm
 *
 *   fma         fused multiply-adds from registers [1e9/s]
 *   add_mul     additions and multiplications as castnet's flags make them [1e9/s]
 *   root_divide 1/sqrt(x) with square root and divide, from the first cache [1e9/s]
 *   BYTES       a = b + s c over arrays of so many bytes in all: two are read, one is read and written [1e9 bytes/s]
 *
 * Processor times, best of several rounds. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { WIDTH = 8, CHAINS = 12 };
typedef double vec __attribute__((vector_size(WIDTH * sizeof(double))));

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

static volatile double sink;

static void keep(const vec *a) {
  double sum = 0;
  for (int k = 0; k < CHAINS; k++)
    for (int l = 0; l < WIDTH; l++) sum += a[k][l];
  sink = sum;
}

/* Independent chains, enough to hide the latency. */
static double arithmetic(int fused) {
  const long rounds = 400000;
  vec a[CHAINS], m, c;
  double best = 1e9;
  for (int l = 0; l < WIDTH; l++) { m[l] = 1.0 - 1e-9 * (l + sink); c[l] = 1e-9; }
  for (int repeat = 0; repeat < 12; repeat++) {
    for (int k = 0; k < CHAINS; k++) a[k] = m + (double)k;
    double began = now();
    if (fused)
      for (long i = 0; i < rounds; i++)
        for (int k = 0; k < CHAINS; k++)
          for (int l = 0; l < WIDTH; l++) a[k][l] = __builtin_fma(a[k][l], m[l], c[l]);
    else
      for (long i = 0; i < rounds; i++)
        for (int k = 0; k < CHAINS; k += 2) { a[k] = a[k] * m; a[k + 1] = a[k + 1] + c; }
    double took = now() - began;
    keep(a);
    best = took < best ? took : best;
  }
  return (double)rounds * CHAINS * WIDTH / best * 1e-9;
}

static double root_divide(void) {
  enum { N = 1024 };
  static double x[N] __attribute__((aligned(64))), y[N] __attribute__((aligned(64)));
  const int rounds = 500;
  double best = 1e9;
  for (int i = 0; i < N; i++) x[i] = 1.0 + 1e-3 * i;
  for (int repeat = 0; repeat < 24; repeat++) {
    double began = now();
    for (int r = 0; r < rounds; r++) {
      for (int i = 0; i < N; i++) y[i] = 1.0 / sqrt(x[i]);
      __asm__ volatile("" : : "r"(x), "r"(y) : "memory");
    }
    double took = now() - began;
    best = took < best ? took : best;
  }
  return (double)rounds * N / best * 1e-9;
}

static double triad(size_t bytes) {
  size_t n = bytes / (3 * sizeof(double)) / WIDTH * WIDTH;
  double *a, best = 1e9;
  if (posix_memalign((void **)&a, 4096, 3 * n * sizeof(double))) exit(1);
  double *restrict p = a, *restrict q = a + n, *restrict s = a + 2 * n;
  for (size_t i = 0; i < 3 * n; i++) a[i] = 1.0 + 1e-9 * i;
  long rounds = 1 + (long)(2e7 / (double)n);
  for (int repeat = 0; repeat < 8; repeat++) {
    double began = now();
    for (long r = 0; r < rounds; r++) {
      for (size_t i = 0; i < n; i++) p[i] = q[i] + 0.5 * s[i];
      __asm__ volatile("" : : "r"(a) : "memory");
    }
    double took = now() - began;
    best = took < best ? took : best;
  }
  free(a);
  return 4.0 * n * sizeof(double) * rounds / best * 1e-9;
}

int main(void) {
  static const size_t sizes[] = {24 << 10, 3 << 19, 16 << 20, 1 << 29};
  printf("fma %.2f\n", arithmetic(1));
  printf("add_mul %.2f\n", arithmetic(0));
  printf("root_divide %.4f\n", root_divide());
  for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) printf("%zu %.2f\n", sizes[i], triad(sizes[i]));
  return 0;
}

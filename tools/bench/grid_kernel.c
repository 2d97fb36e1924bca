/* The yardstick: the net as plain C on a grid, nothing but what the step needs.
 *
 * Square net of n x n nodes without bullets, the same tension law as castnet (square
 * root and divide, clamped), damping, node masses; RK4 or drift-kick-drift with one
 * force evaluation (physics.md, section 4 of the project's notes). Every loop runs over
 * whole rows of the grid with unit stride, so the compiler makes full-width vectors.
 *
 *   cc -O3 -march=native -ffp-contract=off -fno-math-errno -fno-trapping-math \
 *      -mprefer-vector-width=512 grid_kernel.c -lm
 *   ./a.out N rk4|midpoint        prints nanoseconds per node and step
 *
 * -ffp-contract=off as in castnet: the same arithmetic, so the same work. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef double *restrict vec;
typedef const double *restrict in;

static int n, total;
static double stiffness = 350.0, natural, damping = 0.02;
static double *inverse_mass, *cable[2][3];

static double *field(void) {
  double *p;
  if (posix_memalign((void **)&p, 64, (size_t)(total + 2 * n + 64) * sizeof *p)) exit(1);
  memset(p, 0, (size_t)(total + 2 * n + 64) * sizeof *p);
  return p + n + (8 - n % 8) % 8;
}

static void tension(int m, in ax, in ay, in az, in bx, in by, in bz, in au, in av, in aw, in bu, in bv, in bw,
                    vec fx, vec fy, vec fz) {
  double k0 = stiffness, l0 = natural, c0 = damping;
  for (int k = 0; k < m; k++) {
    double dx = bx[k] - ax[k], dy = by[k] - ay[k], dz = bz[k] - az[k];
    double square = dx * dx + dy * dy + dz * dz;
    double inverse = 1.0 / sqrt(square), stretch = square * inverse - l0;
    double rate = (dx * (bu[k] - au[k]) + dy * (bv[k] - av[k]) + dz * (bw[k] - aw[k])) * inverse;
    double t = k0 * stretch + c0 * rate;
    t = t > 0.0 ? t : 0.0;
    t = stretch > 0.0 ? t * inverse : 0.0;
    fx[k] = t * dx; fy[k] = t * dy; fz[k] = t * dz;
  }
}

/* Accelerations of all nodes, row by row. */
static void force(double *x[3], double *v[3], double *a[3]) {
  for (int row = 0; row < n; row++) {
    int b = row * n;
    tension(n - 1, x[0] + b, x[1] + b, x[2] + b, x[0] + b + 1, x[1] + b + 1, x[2] + b + 1, v[0] + b, v[1] + b, v[2] + b,
            v[0] + b + 1, v[1] + b + 1, v[2] + b + 1, cable[0][0] + b, cable[0][1] + b, cable[0][2] + b);
    if (row < n - 1)
      tension(n, x[0] + b, x[1] + b, x[2] + b, x[0] + b + n, x[1] + b + n, x[2] + b + n, v[0] + b, v[1] + b, v[2] + b,
              v[0] + b + n, v[1] + b + n, v[2] + b + n, cable[1][0] + b, cable[1][1] + b, cable[1][2] + b);
    for (int c = 0; c < 3; c++) {
      in y = cable[0][c] + b, z = cable[1][c] + b, yb = cable[0][c] + b - 1, zb = cable[1][c] + b - n;
      in w = inverse_mass + b;
      vec out = a[c] + b;
      for (int k = 0; k < n; k++) out[k] = ((y[k] - yb[k]) + (z[k] - zb[k])) * w[k];
    }
  }
}

static double *x[3], *v[3], *xs[3], *vs[3], *a[3], *sx[3], *sv[3], *ahead[3];

static void first(double h, vec s, vec t, vec xo, vec vo, in q, in r, in x0) {
  for (int k = 0; k < total; k++) { s[k] = q[k]; t[k] = r[k]; xo[k] = x0[k] + h * q[k]; vo[k] = q[k] + h * r[k]; }
}

static void middle(double h, vec s, vec t, vec xo, vec vo, in q, in r, in x0, in v0) {
  for (int k = 0; k < total; k++) {
    double qk = q[k];
    s[k] += 2.0 * qk; t[k] += 2.0 * r[k]; xo[k] = x0[k] + h * qk; vo[k] = v0[k] + h * r[k];
  }
}

static void last(double h, vec xe, vec ve, in s, in t, in q, in r) {
  for (int k = 0; k < total; k++) { xe[k] += h * (s[k] + q[k]); ve[k] += h * (t[k] + r[k]); }
}

static double *xt[3], *vt[3];

static void rk4(double h) {
  force(x, v, a);
  for (int c = 0; c < 3; c++) first(0.5 * h, sx[c], sv[c], xs[c], vs[c], v[c], a[c], x[c]);
  force(xs, vs, a);
  for (int c = 0; c < 3; c++) middle(0.5 * h, sx[c], sv[c], xt[c], vt[c], vs[c], a[c], x[c], v[c]);
  force(xt, vt, a);
  for (int c = 0; c < 3; c++) middle(h, sx[c], sv[c], xs[c], vs[c], vt[c], a[c], x[c], v[c]);
  force(xs, vs, a);
  for (int c = 0; c < 3; c++) last(h / 6.0, x[c], v[c], sx[c], sv[c], vs[c], a[c]);
}

static void kick(double h, vec p, vec u, vec w, in r) {
  for (int k = 0; k < total; k++) {
    double uk = u[k] + h * r[k];
    u[k] = uk; p[k] += h * uk; w[k] = uk + 0.5 * h * r[k];
  }
}

/* Positions stand half a step ahead of the velocities. */
static void midpoint(double h) {
  force(x, ahead, a);
  for (int c = 0; c < 3; c++) kick(h, x[c], v[c], ahead[c], a[c]);
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char **argv) {
  if (argc < 3) return 2;
  n = atoi(argv[1]);
  int is_rk4 = !strcmp(argv[2], "rk4");
  total = n * n;
  natural = 30.0 / (n - 1);
  stiffness = 350.0 / natural;
  double mass = 1.425 / total, h = 0.02 / (n - 1) / 4;
  damping = 0.2 * sqrt(stiffness * mass / 2);
  inverse_mass = field();
  for (int c = 0; c < 3; c++) {
    x[c] = field(); v[c] = field(); xs[c] = field(); vs[c] = field(); xt[c] = field(); vt[c] = field(); a[c] = field(); sx[c] = field(); sv[c] = field();
    ahead[c] = field(); cable[0][c] = field(); cable[1][c] = field();
  }
  for (int i = 0; i < total; i++) {
    int row = i / n, column = i % n, corner = (row == 0 || row == n - 1) && (column == 0 || column == n - 1);
    double y = 0.15 * natural * (column - 0.5 * (n - 1)), z = 0.15 * natural * (row - 0.5 * (n - 1));
    inverse_mass[i] = 1.0 / (corner ? 1.0 : mass);
    x[1][i] = y; x[2][i] = z;
    if (corner) { v[0][i] = 9.06; v[1][i] = y > 0 ? 2.99 : -2.99; v[2][i] = z > 0 ? 2.99 : -2.99; }
    for (int c = 0; c < 3; c++) ahead[c][i] = v[c][i];
  }
  int steps = 1000000 / total > 4 ? 1000000 / total : 4;
  double best = 1e9;
  for (int round = 0; round < 12; round++) {
    double t = now();
    for (int i = 0; i < steps; i++) is_rk4 ? rk4(h) : midpoint(h);
    t = (now() - t) / steps / total * 1e9;
    best = t < best ? t : best;
  }
  double check = 0;
  for (int i = 0; i < total; i++) check += x[0][i];
  printf("kernel %d %s %.3f %.15e\n", total, argv[2], best, check);
  return 0;
}

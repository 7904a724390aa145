/* Closing the loops of one robot along a motion. The functions rp_rows, rp_bias, rp_moved, rp_modes and rp_project, and
   the sizes and tables in capitals, are generated in front of this text, see build.py. No memory is allocated.

   Newton's method is trusted only while it contracts: each step at most CONTRACTION times the one before. Inside that
   radius there is one solution, so that a sample cannot land on another branch (Deuflhard, "Newton Methods for Nonlinear
   Problems", 2004, section 2.1); where it does not contract, the way to the sample is halved. */

#include <math.h>
#include <string.h>

#define CONTRACTION 0.3
#define SETTLED 1e-13   /* a step this small, rad or m, is rounding */
#define FLOOR 1e-9      /* steps below this that no longer shrink are rounding too, next to a singularity */
#define LONGEST 0.5     /* longest first step, rad or m: beyond it the linear model says nothing */
#define SHORTEST 1e-4   /* share of the way to a sample below which it counts as lost */
#define ITERATIONS 15

const int rp_alignments = NALIGN, rp_turning = NT;

enum { CLOSED = 0, LOST = 1, SINGULAR = 2, OTHER_MODE = 3 };

typedef struct {
  double q[NQ];
  double trig[2 * NT + 1]; /* cosine and sine of what turns, computed once a configuration */
  double lu[NP * NP + 1];
  int pivot[NP + 1];
  double sign; /* of det K: it changes across a type I singularity */
  double gap;
} Pose;

/* LU decomposition in place, columns one after the other, with partial pivoting; returns the sign of the determinant. */
static double decompose(double *A, int *pivot) {
  double sign = 1.0;
  for (int j = 0; j < NP; ++j) {
    int best = j;
    for (int i = j + 1; i < NP; ++i)
      if (fabs(A[i + j * NP]) > fabs(A[best + j * NP])) best = i;
    pivot[j] = best;
    double d = A[best + j * NP];
    if (!(d != 0.0)) return 0.0;
    if (best != j) {
      sign = -sign;
      for (int k = 0; k < NP; ++k) {
        double swap = A[j + k * NP];
        A[j + k * NP] = A[best + k * NP];
        A[best + k * NP] = swap;
      }
    }
    if (d < 0.0) sign = -sign;
    double inverse = 1.0 / d;
    for (int i = j + 1; i < NP; ++i) A[i + j * NP] *= inverse;
    for (int k = j + 1; k < NP; ++k) {
      double factor = A[j + k * NP];
      if (factor != 0.0) /* most entries of a mechanism's K are zero */
        for (int i = j + 1; i < NP; ++i) A[i + k * NP] -= factor * A[i + j * NP];
    }
  }
  return sign;
}

static void solve(const double *A, const int *pivot, double *b) {
  for (int j = 0; j < NP; ++j) {
    double swap = b[pivot[j]];
    b[pivot[j]] = b[j];
    b[j] = swap;
  }
  for (int j = 0; j < NP; ++j)
    if (b[j] != 0.0)
      for (int i = j + 1; i < NP; ++i) b[i] -= b[j] * A[i + j * NP];
  for (int j = NP - 1; j >= 0; --j) {
    b[j] /= A[j + j * NP];
    if (b[j] != 0.0)
      for (int i = 0; i < j; ++i) b[i] -= b[j] * A[i + j * NP];
  }
}

/* The inverse, row by row: all columns at once, so that the innermost loop runs over neighbours in memory. */
static void invert(const double *A, const int *pivot, double X[NP + 1][NP + 1]) {
  int from[NP + 1];
  for (int i = 0; i < NP; ++i) from[i] = i;
  for (int j = 0; j < NP; ++j) {
    int swap = from[j];
    from[j] = from[pivot[j]];
    from[pivot[j]] = swap;
  }
  memset(X, 0, (NP + 1) * sizeof *X);
  for (int i = 0; i < NP; ++i) X[i][from[i]] = 1.0;
  for (int j = 0; j < NP; ++j)
    for (int i = j + 1; i < NP; ++i) {
      double factor = A[i + j * NP];
      if (factor != 0.0)
        for (int c = 0; c < NP; ++c) X[i][c] -= factor * X[j][c];
    }
  for (int j = NP - 1; j >= 0; --j) {
    double inverse = 1.0 / A[j + j * NP];
    for (int c = 0; c < NP; ++c) X[j][c] *= inverse;
    for (int i = 0; i < j; ++i) {
      double factor = A[i + j * NP];
      if (factor != 0.0)
        for (int c = 0; c < NP; ++c) X[i][c] -= factor * X[j][c];
    }
  }
}

static void turns_of(const double *q, double *trig) {
  for (int i = 0; i < NT; ++i) {
    trig[2 * i] = cos(q[TURNING[i]]);
    trig[2 * i + 1] = sin(q[TURNING[i]]);
  }
}

static void rows(const double *q, const double *trig, const double *x, double *residual, double *K, double *alignment) {
  const double *arg[] = {q, trig, x};
  double *res[] = {residual, K, alignment};
  rp_rows(arg, res, 0, 0, 0);
}

static void bias_of(const double *q, const double *trig, const double *v, double *bias) {
  const double *arg[] = {q, trig, v};
  double *res[] = {bias};
  rp_bias(arg, res, 0, 0, 0);
}

static void move(double *q, const double *pose_step) {
  double step[NV] = {0.0}, moved[NQ];
  const double *arg[] = {q, step};
  double *res[] = {moved};
  for (int i = 0; i < NP; ++i) step[COLUMNS[i]] = pose_step[i];
  rp_moved(arg, res, 0, 0, 0);
  memcpy(q, moved, sizeof moved);
}

static double largest(const double *values, int size) {
  double result = 0.0;
  for (int i = 0; i < size; ++i)
    if (!(fabs(values[i]) <= result)) result = fabs(values[i]); /* NaN is large */
  return result;
}

/* Newton's method from q, to coordinates that miss x by left (N); returns whether it contracted all the way. */
static int newton(const double *q, const double *x, const double *left, Pose *out) {
  double step[NP + 1], alignment[NALIGN], last = LONGEST / CONTRACTION;
  memcpy(out->q, q, sizeof out->q);
  for (int iteration = 0; iteration < ITERATIONS; ++iteration) {
    turns_of(out->q, out->trig);
    rows(out->q, out->trig, x, step, out->lu, alignment);
    if (left)
      for (int i = 0; i < N; ++i) step[R + i] -= left[i];
    out->gap = largest(step, NP);
    out->sign = decompose(out->lu, out->pivot);
    if (out->sign == 0.0) return 0;
    solve(out->lu, out->pivot, step);
    double size = largest(step, NP);
    int settled = size <= SETTLED || (size <= FLOOR && size > CONTRACTION * last && out->gap < TOLERANCE);
    if (settled) {
      if (!left)
        for (int i = 0; i < NALIGN; ++i)
          if (!(alignment[i] > 0.0)) return 0;
      return 1;
    }
    if (!(size <= CONTRACTION * last)) return 0;
    move(out->q, step);
    last = size;
  }
  return 0;
}

/* From a closed pose to the coordinates x, on the straight way there, the determinant's sign kept. */
static int follow(Pose *pose, const double *x) {
  double residual[NP + 1], K[NP * NP + 1], alignment[NALIGN], left[N + 1], done = 0.0, share = 1.0, sign = pose->sign;
  Pose next;
  rows(pose->q, pose->trig, x, residual, K, alignment);
  while (done < 1.0) {
    double ahead = done + share < 1.0 ? 1.0 - done - share : 0.0;
    for (int i = 0; i < N; ++i) left[i] = ahead * residual[R + i];
    if (newton(pose->q, x, ahead > 0.0 ? left : 0, &next) && next.sign == sign) {
      *pose = next;
      done += share;
      share = fmin(2.0 * share, 1.0 - done);
    } else {
      share *= 0.5;
      if (share < SHORTEST) return 0;
    }
  }
  return 1;
}

/* Velocity and acceleration of the tree at a closed pose, Γ, W and the margin; K v = (0, xd), K a = (0, xdd) - bias. */
static double rates(const Pose *pose, const double *xd, const double *xdd, double *v, double *a, double *gamma, double *W) {
  double size = 0.0, X[NP + 1][NP + 1], bias[NP + 1], rest[NP + 1];
  invert(pose->lu, pose->pivot, X);
  memset(v, 0, NV * sizeof *v);
  memset(a, 0, NV * sizeof *a);
  memset(gamma, 0, NV * N * sizeof *gamma);
  for (int i = 0; i < NP; ++i) {
    double sum = 0.0, speed = 0.0, *of = gamma + COLUMNS[i] * N;
    for (int j = 0; j < NP; ++j) sum += ROW_WEIGHT[j] * X[i][j] * X[i][j];
    for (int j = 0; j < N; ++j) {
      of[j] = X[i][R + j];
      speed += of[j] * xd[j];
    }
    v[COLUMNS[i]] = speed;
    size += WEIGHT[i] * sum;
  }
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < M; ++j) W[i * M + j] = gamma[ACTUATED[j] * N + i];
  bias_of(pose->q, pose->trig, v, bias);
  for (int i = 0; i < NP; ++i) rest[i] = (i < R ? 0.0 : xdd[i - R]) - bias[i];
  for (int i = 0; i < NP; ++i) {
    double sum = 0.0;
    for (int j = 0; j < NP; ++j) sum += X[i][j] * rest[j];
    a[COLUMNS[i]] = sum;
  }
  return size > 0.0 ? 1.0 / sqrt(size) : INFINITY;
}

static int in_mode(const Pose *pose) {
  double values[LEGS + 1];
  const double *arg[] = {pose->q, pose->trig};
  double *res[] = {values};
  if (LEGS) rp_modes(arg, res, 0, 0, 0);
  for (int i = 0; i < LEGS; ++i)
    if (!(values[i] > 0.0)) return 0;
  return 1;
}

/* Place a pose at a configuration that is closed at x: what follow() starts from. */
static int start_at(Pose *pose, const double *q, const double *x) { return newton(q, x, 0, pose); }

/* A motion of `samples` samples from the configuration q0, closed at x0; returns how many were done before one failed,
   with its status in status[]. With `mark`, failing samples get their status and the others go on from q0. */
int rp_lift(int samples, const double *t, const double *x, const double *xd, const double *xdd, const double *q0,
            const double *x0, int mark, double *q, double *trig, double *v, double *a, double *gamma, double *W,
            double *gap, double *margin, int *status) {
  Pose home, pose, next;
  double guess[NQ], step[NP + 1], before = 0.0;
  int known = 0; /* samples before this one, at most two, from which its configuration can be extrapolated */
  if (!start_at(&home, q0, x0)) return -1;
  pose = home;
  for (int k = 0; k < samples; ++k) {
    const double *xk = x + (size_t)k * NX;
    double *vk = v + (size_t)k * NV, *ak = a + (size_t)k * NV, dt = k ? t[k] - t[k - 1] : 0.0;
    int closed = 0;
    if (known) {
      memcpy(guess, pose.q, sizeof guess);
      for (int i = 0; i < NP; ++i) {
        int c = COLUMNS[i];
        double bend = 0.5 * ak[c - NV];
        if (known > 1) bend += (ak[c - NV] - ak[c - 2 * NV]) * dt / (6.0 * before);
        step[i] = dt * (vk[c - NV] + dt * bend);
      }
      move(guess, step);
      closed = newton(guess, xk, 0, &next) && next.sign == pose.sign;
    }
    if (closed)
      pose = next;
    else
      closed = follow(&pose, xk);
    if (!closed && mark) {
      pose = home;
      closed = follow(&pose, xk);
    }
    status[k] = closed ? CLOSED : LOST;
    gap[k] = closed ? pose.gap : NAN;
    if (closed) {
      margin[k] = rates(&pose, xd + (size_t)k * N, xdd + (size_t)k * N, vk, ak, gamma + (size_t)k * NV * N,
                        W + (size_t)k * N * M);
      if (margin[k] < LEAST_MARGIN)
        status[k] = SINGULAR;
      else if (!in_mode(&pose))
        status[k] = OTHER_MODE;
      memcpy(q + (size_t)k * NQ, pose.q, sizeof pose.q);
      memcpy(trig + (size_t)k * 2 * NT, pose.trig, 2 * NT * sizeof *trig);
    }
    if (status[k] == CLOSED) {
      known = known && dt > 0.0 ? 2 : 1; /* where an instant stands twice the acceleration jumps */
      before = dt;
    } else {
      if (!mark) return k;
      known = 0;
      pose = home;
    }
  }
  return samples;
}

/* From one configuration to other coordinates; q is replaced. */
int rp_follow(double *q, const double *x0, const double *x) {
  Pose pose;
  if (!start_at(&pose, q, x0) || !follow(&pose, x)) return LOST;
  memcpy(q, pose.q, sizeof pose.q);
  return in_mode(&pose) ? CLOSED : OTHER_MODE;
}

/* The configuration near q that misses x least (Levenberg and Marquardt); returns the largest residual left, m or rad. */
double rp_assemble(double *q, const double *x) {
  double residual[NP + 1], K[NP * NP + 1], alignment[NALIGN], trial[NQ], trig[2 * NT + 1], damping = 1e-3, size = 0.0;
  turns_of(q, trig);
  rows(q, trig, x, residual, K, alignment);
  for (int i = 0; i < NP; ++i) size += residual[i] * residual[i];
  for (int iteration = 0; iteration < 200 && size > 0.0; ++iteration) {
    double H[NP * NP + 1], step[NP + 1], new_residual[NP + 1], new_K[NP * NP + 1], new_size = 0.0;
    int pivot[NP + 1];
    for (int i = 0; i < NP; ++i) {
      step[i] = 0.0;
      for (int k = 0; k < NP; ++k) step[i] += K[k + i * NP] * residual[k];
      for (int j = 0; j < NP; ++j) {
        double sum = i == j ? damping : 0.0;
        for (int k = 0; k < NP; ++k) sum += K[k + i * NP] * K[k + j * NP];
        H[i + j * NP] = sum;
      }
    }
    if (decompose(H, pivot) == 0.0) break;
    solve(H, pivot, step);
    double longest = largest(step, NP);
    if (longest > 1.0)
      for (int i = 0; i < NP; ++i) step[i] /= longest;
    memcpy(trial, q, sizeof trial);
    move(trial, step);
    turns_of(trial, trig);
    rows(trial, trig, x, new_residual, new_K, alignment);
    for (int i = 0; i < NP; ++i) new_size += new_residual[i] * new_residual[i];
    if (new_size < size) {
      memcpy(q, trial, sizeof trial);
      memcpy(residual, new_residual, sizeof residual);
      memcpy(K, new_K, sizeof K);
      int stalled = new_size > 0.999999 * size && longest < 1e-6;
      size = new_size;
      damping = fmax(damping * 0.2, 1e-15);
      if (stalled || longest < 1e-14) break;
    } else {
      damping *= 8.0;
      if (damping > 1e8) break;
    }
  }
  turns_of(q, trig);
  rows(q, trig, x, residual, K, alignment);
  double gap = largest(residual, NP);
  for (int i = 0; i < NALIGN; ++i)
    if (!(alignment[i] > 0.0)) gap = fmax(gap, acos(fmax(-1.0, alignment[i])));
  return gap;
}

/* Many samples of one generated function, its arguments and results one after the other in memory. */
typedef int (*Generated)(const double **, double **, CASADI_INT *, double *, int);

void rp_map(Generated function, long samples, int inputs, const double **in, const long *in_size, int outputs,
            double **out, const long *out_size) {
  const double *arg[16];
  double *res[16];
  for (long k = 0; k < samples; ++k) {
    for (int i = 0; i < inputs; ++i) arg[i] = in[i] + k * in_size[i];
    for (int i = 0; i < outputs; ++i) res[i] = out[i] + k * out_size[i];
    function(arg, res, 0, 0, 0);
  }
}

/* One sample: in = x, xd, xdd, s, sd, sdd; out = W, f, carrier forces, gap, margin. state is where Newton starts, and
   afterwards where it ended: the configuration, and the determinant's sign (0: not known). Nothing is written unless the
   sample is closed on the same side of every type I singularity. */
int rp_sample(double *state, const double *in, double *out) {
  const double *x = in, *xd = in + NX, *xdd = xd + N, *s = xdd + N;
  double v[NV], a[NV], gamma[NV * N + 1], W[N * M + 1], f[N + 1], force[NK + 1];
  Pose pose;
  if (!newton(state, x, 0, &pose) || pose.sign * state[NQ] < 0.0) return LOST;
  double margin = rates(&pose, xd, xdd, v, a, gamma, W);
  if (margin < LEAST_MARGIN) return SINGULAR;
  if (!in_mode(&pose)) return OTHER_MODE;
  const double *arg[] = {pose.q, pose.trig, v, a, gamma, s, s + NK, s + 2 * NK};
  double *res[] = {f, force};
  rp_project(arg, res, 0, 0, 0);
  memcpy(state, pose.q, sizeof pose.q);
  state[NQ] = pose.sign;
  memcpy(out, W, N * M * sizeof *out);
  memcpy(out + N * M, f, N * sizeof *out);
  memcpy(out + N * M + N, force, NK * sizeof *out);
  out[N * M + N + NK] = pose.gap;
  out[N * M + N + NK + 1] = margin;
  return CLOSED;
}

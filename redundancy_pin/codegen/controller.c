/* What a controller calls; see the header. This text stands behind driver.c and the tables of one robot; robot_ and
   ROBOT_ in it become the prefix. Nothing is static but constants, nothing is allocated, every loop has a bound. */

#define SWEEPS 30     /* over all pairs of columns; the convergence is quadratic, 6 x 6 takes some eight */
#define OBLIQUE 1e-15 /* cosine of the angle between two columns below which they count as orthogonal */
#define SHORT (N < M ? N : M)
#define LONG (N < M ? M : N)

static int finite(const double *values, int size) {
  for (int i = 0; i < size; ++i)
    if (!isfinite(values[i])) return 0;
  return 1;
}

/* --- W without units, its singular values, and what is solved with them ----------------------------------------- */

/* The scaled matrix A = Dx^-1 W Da, or its transpose where it has more columns than rows, times a rotation: its columns
   are then orthogonal, their lengths are the singular values, and the rotation holds the other singular vectors
   (one-sided Jacobi; Demmel and Veselic, "Jacobi's method is more accurate than QR", 1992). */
typedef struct {
  double column[SHORT][LONG];
  double turn[SHORT][SHORT]; /* columns of the rotation, one a row */
  double square[SHORT];      /* squared singular values */
  int kept[SHORT];           /* which of them are no rounding */
  int rank;
  double margin, condition;
} Spectrum;

static double dot(const double *a, const double *b, int size) {
  double sum = 0.0;
  for (int i = 0; i < size; ++i) sum += a[i] * b[i];
  return sum;
}

static void rotate(double *x, double *y, int size, double cosine, double sine) {
  for (int i = 0; i < size; ++i) {
    double turned = cosine * x[i] - sine * y[i];
    y[i] = sine * x[i] + cosine * y[i];
    x[i] = turned;
  }
}

static void spectrum_of(const double *W, Spectrum *s) {
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < M; ++j) {
      double entry = W[i * M + j] * (COLUMN_SCALE[j] / ROW_SCALE[i]);
#if M > N
      s->column[i][j] = entry;
#else
      s->column[j][i] = entry;
#endif
    }
  for (int p = 0; p < SHORT; ++p)
    for (int q = 0; q < SHORT; ++q) s->turn[p][q] = p == q ? 1.0 : 0.0;
  for (int sweep = 0, moved = 1; moved && sweep < SWEEPS; ++sweep) {
    moved = 0;
    for (int p = 0; p < SHORT; ++p)
      for (int q = p + 1; q < SHORT; ++q) {
        double xx = dot(s->column[p], s->column[p], LONG), yy = dot(s->column[q], s->column[q], LONG);
        double xy = dot(s->column[p], s->column[q], LONG), half = 0.5 * (yy - xx);
        if (!(fabs(xy) > OBLIQUE * sqrt(xx) * sqrt(yy))) continue;
        double root = hypot(half, xy), tangent = xy / (half < 0.0 ? half - root : half + root);
        double cosine = 1.0 / sqrt(1.0 + tangent * tangent);
        rotate(s->column[p], s->column[q], LONG, cosine, cosine * tangent);
        rotate(s->turn[p], s->turn[q], SHORT, cosine, cosine * tangent);
        moved = 1;
      }
  }
  double most = 0.0, least = INFINITY;
  for (int p = 0; p < SHORT; ++p) {
    s->square[p] = dot(s->column[p], s->column[p], LONG);
    most = fmax(most, sqrt(s->square[p]));
    least = fmin(least, sqrt(s->square[p]));
  }
  s->rank = 0;
  for (int p = 0; p < SHORT; ++p) {
    s->kept[p] = sqrt(s->square[p]) > RANK_TOLERANCE * fmax(most, 1.0);
    s->rank += s->kept[p];
  }
  s->margin = least;
  s->condition = least > 0.0 ? most / least : INFINITY;
}

/* Pseudo-inverses: of the matrix whose columns were rotated, and of its transpose. */
static void from_long(const Spectrum *s, const double *given, double *result) {
  clear(result, SHORT);
  for (int p = 0; p < SHORT; ++p) {
    if (!s->kept[p]) continue;
    double along = dot(s->column[p], given, LONG) / s->square[p];
    for (int i = 0; i < SHORT; ++i) result[i] += along * s->turn[p][i];
  }
}

#if M >= N
static void from_short(const Spectrum *s, const double *given, double *result) {
  clear(result, LONG);
  for (int p = 0; p < SHORT; ++p) {
    if (!s->kept[p]) continue;
    double along = dot(s->turn[p], given, SHORT) / s->square[p];
    for (int i = 0; i < LONG; ++i) result[i] += along * s->column[p][i];
  }
}
#endif

/* Divides values (size) by a power of two that brings the largest to a size of one, so that their squares neither overflow
   nor vanish; returns its exponent. Nothing is rounded: results times that power are those of the values themselves. */
static int brought_down(double *values, int size) {
  int exponent = 0; /* frexp leaves it where the largest is not finite */
  frexp(largest(values, size), &exponent);
  for (int i = 0; i < size; ++i) values[i] = ldexp(values[i], -exponent);
  return exponent;
}

/* The least u with A u = g, and how much of g lies outside the range of A. */
static double least_norm(const Spectrum *s, const double *g, double *u) {
  double outside = 0.0;
#if M > N
  from_short(s, g, u);
  for (int p = 0; p < SHORT; ++p) {
    double along = s->kept[p] ? 0.0 : dot(s->turn[p], g, SHORT);
    outside += along * along;
  }
#else
  double rest[N];
  from_long(s, g, u);
  copy(rest, g, N);
  for (int p = 0; p < SHORT; ++p) {
    double along = s->kept[p] ? dot(s->column[p], g, LONG) / s->square[p] : 0.0;
    for (int i = 0; i < N; ++i) rest[i] -= along * s->column[p][i];
  }
  outside = s->rank < N ? dot(rest, rest, N) : 0.0;
#endif
  return sqrt(outside);
}

/* The size of the forces of a motion before they cancel, N: Scales.force of redundancy_pin. */
static double force_size_of(const robot_motion *motion) {
  double rate = 0.0, acceleration = 0.0;
  for (int i = 0; i < N; ++i) {
    rate = fmax(rate, fabs(motion->xd[i]) / EQUATION_UNIT[R + i]);
    acceleration = fmax(acceleration, fabs(motion->xdd[i]) / EQUATION_UNIT[R + i]);
  }
#if NK
  for (int i = 0; i < NK; ++i) {
    rate = fmax(rate, fabs(motion->sd[i]) / CARRIER_UNIT[i]);
    acceleration = fmax(acceleration, fabs(motion->sdd[i]) / CARRIER_UNIT[i]);
  }
#endif
  return MASS * (GRAVITY + LENGTH * (rate * rate + acceleration)) + VISCOUS * rate + STATIC;
}

/* tau with W tau = f, or NaN; the decisions are those of redundancy_pin.distribute. Nothing is written where a result is
   beyond what a double holds. */
static int distribute(const double *W, const double *f, double force_size, robot_efforts *out) {
  Spectrum s;
  double g[N], u[M], missing = 0.0, size = 0.0;
  for (int i = 0; i < N; ++i) g[i] = f[i] / ROW_SCALE[i];
  if (!finite(g, N)) return ROBOT_NOT_FINITE;
  int exponent = brought_down(g, N);
  spectrum_of(W, &s);
  double outside = least_norm(&s, g, u);
  for (int i = 0; i < N; ++i) {
    double row = -g[i];
    for (int j = 0; j < M; ++j) row += W[i * M + j] * (COLUMN_SCALE[j] / ROW_SCALE[i]) * u[j];
    missing += row * row;
    size += g[i] * g[i];
  }
  int consistent = outside <= CONSISTENCY_TOLERANCE * sqrt(size) + ldexp(FORCE_TOLERANCE * force_size, -exponent);
  int full = s.rank == SHORT;
  double residual = ldexp(consistent ? sqrt(missing) : outside, exponent);
  for (int j = 0; j < M; ++j) u[j] = ldexp(u[j] * COLUMN_SCALE[j], exponent);
  if ((consistent && !finite(u, M)) || !isfinite(residual)) return ROBOT_NOT_FINITE;
  for (int j = 0; j < M; ++j) out->tau[j] = consistent ? u[j] : (double)NAN;
  out->residual = residual;
  out->margin = s.margin;
  out->condition = s.condition;
  out->rank = s.rank;
  if (consistent && !full) return ROBOT_SINGULAR_CONSISTENT;
  if (consistent) return s.margin < NEAR_SINGULAR ? ROBOT_NEAR_SINGULAR : ROBOT_OK;
  return full ? ROBOT_UNDERACTUATED : ROBOT_SINGULAR_INCONSISTENT;
}

/* --- states -------------------------------------------------------------------------------------------------------- */

static int status_of(int closed) {
  static const int STATUS[] = {ROBOT_OK, ROBOT_UNREACHABLE, ROBOT_TYPE_I, ROBOT_BRANCH_LOST, ROBOT_NOT_FINITE};
  return STATUS[closed];
}

static void coordinates_of(const double *q, const double *trig, double *x) {
  const double *const arg[] = {q, trig};
  double *const res[] = {x};
  rp_coordinates(arg, res);
}

/* The pose that a state stands for, and its coordinates; returns a status. */
static int pose_of(const robot_state *state, Pose *pose, double *x) {
  double trig[2 * NT + 1];
  if (!finite(state->q, NQ) || !isfinite(state->sign)) return ROBOT_NOT_FINITE;
  turns_of(state->q, trig);
  coordinates_of(state->q, trig, x);
  if (!start_at(pose, state->q, x) || pose->sign * state->sign < 0.0) return ROBOT_UNREACHABLE;
  return ROBOT_OK;
}

int robot_reset(robot_state *state) {
  robot_state home;
  Pose pose;
  double x[NX];
  copy(home.q, REFERENCE, NQ);
  home.sign = 0.0;
  int status = pose_of(&home, &pose, x);
  if (status) return status;
  copy(state->q, pose.q, NQ);
  state->sign = pose.sign;
  return ROBOT_OK;
}

int robot_go_to(robot_state *state, const double x[ROBOT_NX]) {
  Pose pose;
  double here[NX];
  if (!finite(x, NX)) return ROBOT_NOT_FINITE;
  int status = pose_of(state, &pose, here);
  if (status) return status;
  if (!go_far(&pose, here, x)) return ROBOT_UNREACHABLE;
  if (!in_mode(&pose)) return ROBOT_BRANCH_LOST;
  copy(state->q, pose.q, NQ);
  state->sign = pose.sign;
  return ROBOT_OK;
}

/* --- inverse dynamics ---------------------------------------------------------------------------------------------- */

int robot_inverse_dynamics(robot_state *state, const robot_motion *motion, robot_efforts *efforts) {
  double in[NX + 2 * N + 3 * NK], out[N * M + N + NK + 2], from[NQ + 1];
  double *const W = out, *const f = out + N * M, *const rest = f + N;
  copy(in, motion->x, NX);
  copy(in + NX, motion->xd, N);
  copy(in + NX + N, motion->xdd, N);
#if NK
  copy(in + NX + 2 * N, motion->s, NK);
  copy(in + NX + 2 * N + NK, motion->sd, NK);
  copy(in + NX + 2 * N + 2 * NK, motion->sdd, NK);
#endif
  copy(from, state->q, NQ);
  from[NQ] = state->sign;
  if (!finite(in, NX + 2 * N + 3 * NK) || !finite(from, NQ + 1)) return ROBOT_NOT_FINITE;
  int closed = rp_sample(from, in, out);
  if (closed != CLOSED) return status_of(closed);
  if (!finite(out, N * M + N + NK + 2)) return ROBOT_NOT_FINITE; /* rates so large that forces overflow */
  int status = distribute(W, f, force_size_of(motion), efforts);
  if (status == ROBOT_NOT_FINITE) return status;
  copy(state->q, from, NQ);
  state->sign = from[NQ];
  for (int i = 0; i < N; ++i) copy(efforts->W[i], W + i * M, M);
  copy(efforts->f, f, N);
#if NK
  copy(efforts->carrier_force, rest, NK);
#endif
  efforts->gap = rest[NK];
  efforts->type_I_margin = rest[NK + 1];
  return status;
}

/* --- forward kinematics -------------------------------------------------------------------------------------------- */

#if M >= N
static void drives(const double *q, const double *position, double *off) {
  const double *const arg[] = {q, position};
  double *const res[] = {off};
  rp_drives(arg, res);
}

/* The pseudo-inverse of W^T: rates of the coordinates whose actuated rates miss those given least. */
static void back(const Spectrum *s, const double *rate, double *xd) {
  double scaled[M], result[N];
  for (int j = 0; j < M; ++j) scaled[j] = rate[j] * COLUMN_SCALE[j];
#if M > N
  from_long(s, scaled, result);
#else
  from_short(s, scaled, result);
#endif
  for (int i = 0; i < N; ++i) xd[i] = result[i] / ROW_SCALE[i];
}

/* Newton's method for closures and actuated positions at once (of more actuators than freedoms Gauss and Newton's, with
   the closures kept); the loops close to first order by X (row by row the inverse of K), then the coordinates move by
   dx with W^T dx = what the actuators miss. It is trusted while it contracts, as newton() is. */
static int forward(Pose *pose, const double *position, double *off) {
  double step[NP + 1], alignment[NALIGN], closing[NV], at_rest[M], dx[N], W[N * M], x[NX], last = LONGEST / CONTRACTION;
  double X[NP + 1][NP + 1];
  Spectrum s;
  coordinates_of(pose->q, pose->trig, x);
  for (int iteration = 0; iteration < ITERATIONS; ++iteration) {
    double sign = pose->sign;
    rows(pose->q, pose->trig, x, step, pose->lu, alignment);
    pose->gap = largest(step, R);
    pose->sign = decompose(pose->lu, pose->pivot);
    if (pose->sign * sign <= 0.0) return ROBOT_UNREACHABLE;
    invert(pose->lu, pose->pivot, X);
    clear(closing, NV);
    for (int i = 0; i < NP; ++i) closing[COLUMNS[i]] = dot(X[i], step, R) * STEP_UNIT[i];
    drives(pose->q, position, off);
    for (int j = 0; j < M; ++j) at_rest[j] = off[j] - closing[ACTUATED[j]];
    for (int i = 0; i < NP; ++i)
      for (int j = 0; j < M; ++j)
        if (ACTUATED[j] == COLUMNS[i])
          for (int c = 0; c < N; ++c) W[c * M + j] = X[i][R + c] * (STEP_UNIT[i] / EQUATION_UNIT[R + c]);
    spectrum_of(W, &s);
    if (s.rank < N) return ROBOT_TYPE_II;
    back(&s, at_rest, dx);
    for (int c = 0; c < N; ++c) dx[c] /= EQUATION_UNIT[R + c];
    for (int i = 0; i < NP; ++i) step[i] = closing[COLUMNS[i]] / STEP_UNIT[i] + dot(X[i] + R, dx, N);
    double size = largest(step, NP);
    if (size <= SETTLED || (size <= FLOOR && size > CONTRACTION * last && pose->gap < TOLERANCE)) return ROBOT_OK;
    if (!(size <= CONTRACTION * last)) return ROBOT_UNREACHABLE;
    for (int i = 0; i < NP; ++i) step[i] *= STEP_UNIT[i];
    move(pose->q, step);
    turns_of(pose->q, pose->trig);
    last = size;
  }
  return ROBOT_UNREACHABLE;
}

int robot_forward_kinematics(robot_state *state, const robot_drives *given, robot_platform *platform) {
  Pose pose;
  Spectrum s;
  double x[NX], xd[N], none[N], off[M], rate[M], v[NV], a[NV], gamma[NV * N], W[N * M];
  double residual[NP + 1], K[NP * NP + 1], alignment[NALIGN];
  if (!finite(given->position, M) || !finite(given->velocity, M)) return ROBOT_NOT_FINITE;
  int status = pose_of(state, &pose, x);
  if (status) return status;
  status = forward(&pose, given->position, off);
  if (status) return status;
  coordinates_of(pose.q, pose.trig, x);
  rows(pose.q, pose.trig, x, residual, K, alignment);
  for (int i = 0; i < NALIGN; ++i)
    if (!(alignment[i] > 0.0)) return ROBOT_UNREACHABLE; /* a hinge the wrong way round */
  clear(none, N);
  double margin = rates(&pose, none, none, v, a, gamma, W);
  if (!(margin >= LEAST_MARGIN)) return ROBOT_TYPE_I;
  if (!in_mode(&pose)) return ROBOT_BRANCH_LOST;
  spectrum_of(W, &s);
  if (s.rank < N) return ROBOT_TYPE_II;
  copy(rate, given->velocity, M);
  int exponent = brought_down(rate, M);
  back(&s, rate, xd);
  for (int i = 0; i < N; ++i) xd[i] = ldexp(xd[i], exponent);
  if (!finite(xd, N)) return ROBOT_NOT_FINITE;
  copy(state->q, pose.q, NQ);
  state->sign = pose.sign;
  copy(platform->x, x, NX);
  copy(platform->xd, xd, N);
  for (int j = 0; j < M; ++j) off[j] *= COLUMN_SCALE[j];
  platform->mismatch = sqrt(dot(off, off, M));
  platform->gap = pose.gap * LENGTH;
  platform->margin = s.margin;
  platform->type_I_margin = margin;
  return s.margin < NEAR_SINGULAR ? ROBOT_NEAR_SINGULAR : ROBOT_OK;
}
#endif

/* --- Jacobians and margins ----------------------------------------------------------------------------------------- */

int robot_jacobians_at(const robot_state *state, robot_jacobians *out) {
  Pose pose;
  double x[NX], none[N], v[NV], a[NV], gamma[NV * N], W[N * M];
  int status = pose_of(state, &pose, x);
  if (status) return status;
  clear(none, N);
  if (!(rates(&pose, none, none, v, a, gamma, W) >= LEAST_MARGIN)) return ROBOT_TYPE_I;
#if R
  double residual[NP + 1], K[NP * NP + 1], alignment[NALIGN];
  rows(pose.q, pose.trig, x, residual, K, alignment);
  clear(&out->closure[0][0], R * NV);
  for (int i = 0; i < R; ++i)
    for (int j = 0; j < NP; ++j) out->closure[i][COLUMNS[j]] = K[i + j * NP] * (EQUATION_UNIT[i] / STEP_UNIT[j]);
#endif
  for (int i = 0; i < NV; ++i) copy(out->gamma[i], gamma + i * N, N);
  for (int i = 0; i < N; ++i) copy(out->W[i], W + i * M, M);
  return ROBOT_OK;
}

int robot_margins_at(const robot_state *state, robot_margins *out) {
  Pose pose;
  Spectrum s;
  double x[NX], none[N], v[NV], a[NV], gamma[NV * N], W[N * M];
  int status = pose_of(state, &pose, x);
  if (status) return status;
  clear(none, N);
  double margin = rates(&pose, none, none, v, a, gamma, W);
  spectrum_of(W, &s);
  if (!(margin >= LEAST_MARGIN)) return ROBOT_TYPE_I;
  out->type_I = margin;
  out->type_II = s.margin;
  out->condition = s.condition;
  out->rank = s.rank;
  return ROBOT_OK;
}

/* One sample: efforts that balance W tau = f, with a status, and the platform from its actuators. Controllers (codegen) and
   calls from Python share this text. It follows driver.c and the tables of one robot. Nothing is allocated, every loop has
   a bound. Statuses are those of redundancy_pin.status. */

#define SHORT (N < M ? N : M)
#define LONG (N < M ? M : N)

static void coordinates_of(const double *numbers, const double *q, const double *trig, double *x) {
  const double *const arg[] = {q, trig, numbers};
  double *const res[] = {x};
  rp_coordinates(arg, res);
}

/* The pose and the coordinates of a configuration; sign is that of its determinant, 0 where unknown. Returns a status. */
static int pose_at(const double *numbers, const double *q, double sign, Pose *pose, double *x) {
  double trig[2 * NT + 1];
  if (!finite(q, NQ) || !isfinite(sign)) return STATUS_NOT_FINITE;
  turns_of(q, trig);
  coordinates_of(numbers, q, trig, x);
  if (!newton(numbers, q, x, 0, pose) || pose->sign * sign < 0.0) return STATUS_UNREACHABLE;
  return STATUS_OK;
}

#if M

/* --- W without units, its singular values, and what is solved with them ----------------------------------------- */

/* The scaled matrix A = Dx^-1 W Da, or its transpose where it has more columns than rows, times a rotation: its columns
   are then orthogonal, their lengths are the singular values, and the rotation holds the other singular vectors. */
typedef struct {
  double row[SHORT][LONG + SHORT]; /* a column of the product, then one of the rotation */
  double square[SHORT];            /* squared singular values */
  int kept[SHORT];                 /* which of them are no rounding */
  int rank;
  double margin, condition;
} Spectrum;

static void spectrum_of(const double *numbers, const double *W, Spectrum *s) {
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < M; ++j) {
      double entry = W[i * M + j] * (COLUMN_SCALE[j] / ROW_SCALE[i]);
#if M > N
      s->row[i][j] = entry;
#else
      s->row[j][i] = entry;
#endif
    }
  for (int p = 0; p < SHORT; ++p)
    for (int q = 0; q < SHORT; ++q) s->row[p][LONG + q] = p == q ? 1.0 : 0.0;
  orthogonalise(&s->row[0][0], SHORT, LONG, LONG + SHORT, s->square);
  double most = 0.0, least = INFINITY;
  for (int p = 0; p < SHORT; ++p) {
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
    double along = dot(s->row[p], given, LONG) / s->square[p];
    for (int i = 0; i < SHORT; ++i) result[i] += along * s->row[p][LONG + i];
  }
}

#if M >= N
static void from_short(const Spectrum *s, const double *given, double *result) {
  clear(result, LONG);
  for (int p = 0; p < SHORT; ++p) {
    if (!s->kept[p]) continue;
    double along = dot(s->row[p] + LONG, given, SHORT) / s->square[p];
    for (int i = 0; i < LONG; ++i) result[i] += along * s->row[p][i];
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
    double along = s->kept[p] ? 0.0 : dot(s->row[p] + LONG, g, SHORT);
    outside += along * along;
  }
#else
  double rest[N];
  from_long(s, g, u);
  copy(rest, g, N);
  for (int p = 0; p < SHORT; ++p) {
    double along = s->kept[p] ? dot(s->row[p], g, LONG) / s->square[p] : 0.0;
    for (int i = 0; i < N; ++i) rest[i] -= along * s->row[p][i];
  }
  outside = s->rank < N ? dot(rest, rest, N) : 0.0;
#endif
  return sqrt(outside);
}

/* The size of the forces of a motion before they cancel, N: force_sizes of redundancy_pin. in: as rp_sample. */
static double force_size_of(const double *numbers, const double *in) {
  const double *xd = in + NX, *xdd = xd + N, *sd = xdd + N + NK, *sdd = sd + NK;
  double rate = 0.0, acceleration = 0.0;
  for (int i = 0; i < N; ++i) {
    rate = fmax(rate, fabs(xd[i]) / EQUATION_UNIT[R + i]);
    acceleration = fmax(acceleration, fabs(xdd[i]) / EQUATION_UNIT[R + i]);
  }
  for (int i = 0; i < NK; ++i) {
    rate = fmax(rate, fabs(sd[i]) / VELOCITY_UNIT[CARRIERS[i]]);
    acceleration = fmax(acceleration, fabs(sdd[i]) / VELOCITY_UNIT[CARRIERS[i]]);
  }
  double external = 0.0;
  for (const double *wrench = sdd + NK; wrench < sdd + NK + NWRENCH; wrench += 6)
    external += fmax(largest(wrench, 3), largest(wrench + 3, 3) / LENGTH);
  return MASS * (GRAVITY + LENGTH * (rate * rate + acceleration)) + VISCOUS * rate + STATIC + external;
}

/* Efforts of one sample; residual, margin and condition as in redundancy_pin.Distribution. */
typedef struct {
  double tau[M], residual, margin, condition;
  int rank;
} Efforts;

/* tau with W tau = f, or NaN; the decisions are those of redundancy_pin.distribute. Nothing is written where a result is
   beyond what a double holds. */
APART int distribute(const double *numbers, const double *W, const double *f, double force_size, Efforts *out) {
  Spectrum s;
  double g[N], u[M], missing = 0.0, size = 0.0;
  for (int i = 0; i < N; ++i) g[i] = f[i] / ROW_SCALE[i];
  if (!finite(g, N)) return STATUS_NOT_FINITE;
  int exponent = brought_down(g, N);
  spectrum_of(numbers, W, &s);
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
  if ((consistent && !finite(u, M)) || !isfinite(residual)) return STATUS_NOT_FINITE;
  for (int j = 0; j < M; ++j) out->tau[j] = consistent ? u[j] : (double)NAN;
  out->residual = residual;
  out->margin = s.margin;
  out->condition = s.condition;
  out->rank = s.rank;
  if (consistent && !full) return STATUS_SINGULAR_CONSISTENT;
  if (consistent) return s.margin < NEAR_SINGULAR ? STATUS_NEAR_SINGULAR : STATUS_OK;
  return full ? STATUS_UNDERACTUATED : STATUS_SINGULAR_INCONSISTENT;
}

/* --- forward kinematics -------------------------------------------------------------------------------------------- */

#if M >= N
static void drives(const double *q, const double *position, double *off) {
  const double *const arg[] = {q, position};
  double *const res[] = {off};
  rp_drives(arg, res);
}

/* The pseudo-inverse of W^T: rates of the coordinates whose actuated rates miss those given least. */
static void back(const double *numbers, const Spectrum *s, const double *rate, double *xd) {
  double scaled[M], result[N];
  for (int j = 0; j < M; ++j) scaled[j] = rate[j] * COLUMN_SCALE[j];
#if M > N
  from_long(s, scaled, result);
#else
  from_short(s, scaled, result);
#endif
  for (int i = 0; i < N; ++i) xd[i] = result[i] / ROW_SCALE[i];
}

/* [J_c; S] without unit, decomposed; it serves for steps so small that its own change does not slow them down. */
typedef struct {
  double A[NP * NP + 1];
  int pivot[NP + 1];
  int known;
} Driven;

#if M == N
/* Newton's step (NP) for closures and actuators at once, [J_c; S] step = [residual; off] without unit; returns 0 where it is singular. */
static int actuated_step(const double *numbers, Pose *pose, const double *off, double *step, Driven *driven) {
  if (!driven->known)
    for (int j = 0; j < NP; ++j)
      for (int i = 0; i < R; ++i) driven->A[i + j * NP] = pose->lu[ENTRY(i, j)];
  for (int i = 0; i < NP; ++i)
    for (int j = 0; j < M; ++j) {
      int drives_it = ACTUATED[j] == COLUMNS[i];
      if (!driven->known) driven->A[R + j + i * NP] = drives_it;
      if (drives_it) step[R + j] = off[j] / VELOCITY_UNIT[COLUMNS[i]];
    }
  if (!driven->known && decompose(driven->A, NP, driven->pivot) == 0.0) return 0;
  driven->known = 1;
  solve(driven->A, NP, driven->pivot, step);
  return 1;
}
#else
/* The step of Gauss and Newton's method, of more actuators than DOF: the loops close to first order, then the coordinates move by dx with
   W^T dx nearest to what the actuators miss. Returns 0 where that is singular. */
static int actuated_step(const double *numbers, Pose *pose, const double *off, double *step, Driven *driven) {
  double closing[NV] = {0.0}, rest[M], dx[N], gamma[NV * N], W[N * M];
  Spectrum s;
  Pose here = *pose;
  driven->known = 0;
  if (decompose_rows(here.lu, here.pivot) == 0.0) return 0;
  invert_pose(numbers, &here, gamma, W);
  spectrum_of(numbers, W, &s);
  if (s.rank < N) return 0;
  clear(step + R, N);
  solve_rows(here.lu, here.pivot, step);
  for (int i = 0; i < NP; ++i) closing[COLUMNS[i]] = step[i] * VELOCITY_UNIT[COLUMNS[i]];
  for (int j = 0; j < M; ++j) rest[j] = off[j] - closing[ACTUATED[j]];
  back(numbers, &s, rest, dx);
  for (int i = 0; i < NP; ++i) step[i] += dot(gamma + COLUMNS[i] * N, dx, N) / VELOCITY_UNIT[COLUMNS[i]];
  return 1;
}
#endif

/* Why Newton's method failed at a pose with K not decomposed yet. */
static int failure_at(const double *numbers, Pose *pose) {
  double gamma[NV * N], W[N * M];
  Spectrum s;
  if (decompose_rows(pose->lu, pose->pivot) == 0.0) return STATUS_TYPE_I;
  invert_pose(numbers, pose, gamma, W);
  spectrum_of(numbers, W, &s);
  return s.rank < N ? STATUS_TYPE_II : STATUS_UNREACHABLE;
}

/* Newton's method for closures and actuated positions at once, to positions that miss those given by left (M, or null). It is
   trusted while it contracts, as newton() is. The pose ends with K decomposed, on the same side of type I singularities
   where its sign says which (not 0). Returns a status. */
static int forward(const double *numbers, Pose *pose, const double *position, const double *left, double *off) {
  double step[NP + 1], alignment[NALIGN], x[NX], last = LONGEST / CONTRACTION, sign = pose->sign;
  Driven driven;
  driven.known = 0;
  coordinates_of(numbers, pose->q, pose->trig, x);
  for (int iteration = 0; iteration < ITERATIONS; ++iteration) {
    rows(numbers, pose->q, pose->trig, x, step, pose->lu, alignment);
    pose->residual = largest(step, R);
    drives(pose->q, position, off);
    if (left)
      for (int j = 0; j < M; ++j) off[j] -= left[j];
    int reused = driven.known = driven.known && last * last <= FLOOR;
    if (!actuated_step(numbers, pose, off, step, &driven)) return failure_at(numbers, pose);
    double size = largest(step, NP);
    if (size <= SETTLED || (size <= FLOOR && size > CONTRACTION * last && pose->residual < TOLERANCE)) {
      for (int i = 0; i < NALIGN; ++i)
        if (!(alignment[i] > 0.0)) return STATUS_UNREACHABLE; /* a hinge the wrong way round */
      pose->sign = decompose_rows(pose->lu, pose->pivot);
      return pose->sign != 0.0 && !(pose->sign * sign < 0.0) ? STATUS_OK : STATUS_UNREACHABLE;
    }
    if (!(size <= CONTRACTION * last)) {
      if (!reused) return failure_at(numbers, pose);
      driven.known = 0; /* again with its own matrix */
      continue;
    }
    for (int i = 0; i < NP; ++i) step[i] *= VELOCITY_UNIT[COLUMNS[i]];
    move(pose->q, step);
    turns_of(pose->q, pose->trig);
    last = size;
  }
  return STATUS_UNREACHABLE;
}

/* The platform at the pose of its actuators; gamma (NV x N), others as in robot_platform of generated headers. */
typedef struct {
  double x[NX], xd[N], gamma[NV * N], mismatch, residual, margin, type_I_margin;
} Platform;

/* The platform from positions and velocities (M each) of its actuators, on the branch of the pose, which is moved there.
   Returns a status; the platform is written where it is OK or NEAR_SINGULAR. */
static int platform_of(const double *numbers, Pose *pose, const double *position, const double *velocity, Platform *out) {
  Spectrum s;
  double off[M], rate[M], W[N * M];
  clear(out->x, NX);
  clear(out->xd, N);
  out->mismatch = out->residual = out->margin = out->type_I_margin = 0.0;
  int status = forward(numbers, pose, position, 0, off);
  if (status) return status;
  coordinates_of(numbers, pose->q, pose->trig, out->x);
  out->type_I_margin = invert_pose(numbers, pose, out->gamma, W);
  if (!(out->type_I_margin >= SINGULAR_MARGIN)) return STATUS_TYPE_I;
  if (!in_mode(numbers, pose)) return STATUS_BRANCH_LOST;
  spectrum_of(numbers, W, &s);
  if (s.rank < N) return STATUS_TYPE_II;
  copy(rate, velocity, M);
  int exponent = brought_down(rate, M);
  back(numbers, &s, rate, out->xd);
  for (int i = 0; i < N; ++i) out->xd[i] = ldexp(out->xd[i], exponent);
  if (!finite(out->xd, N)) return STATUS_NOT_FINITE;
  for (int j = 0; j < M; ++j) off[j] *= COLUMN_SCALE[j];
  out->mismatch = sqrt(dot(off, off, M));
  out->residual = pose->residual * LENGTH;
  out->margin = s.margin;
  return s.margin < NEAR_SINGULAR ? STATUS_NEAR_SINGULAR : STATUS_OK;
}
#endif
#endif

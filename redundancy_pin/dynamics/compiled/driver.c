/* Closing the loops of one robot. The functions rp_rows, rp_bias, rp_modes and rp_project, and the sizes and tables in
   capitals, are generated in front of this text, see build.py; so is tree.c.

   Newton's method is trusted only while it contracts: each step at most CONTRACTION times the one before. Inside that
   radius there is one solution, so that a sample cannot land on another branch (Deuflhard, "Newton Methods for Nonlinear
   Problems", 2004, section 2.1); where it does not contract, the way to the sample is halved.

   Residuals, K and Newton's steps have no unit: lengths are over the characteristic length (EQUATION_UNIT, VELOCITY_UNIT). */


#define CONTRACTION 0.3 /* ratio of two steps of Newton's method, no unit; below 1/2 one solution is in reach (Deuflhard) */
#define LONGEST 0.5     /* longest first step, rad or characteristic lengths: beyond it the linear model says nothing */
#define FLOOR 1e-9      /* rad or characteristic lengths: smaller steps that no longer shrink are rounding next to a singularity */
#define SETTLED (0.01 * TOLERANCE) /* so are all steps this small: a hundredth of the tolerance of closures */
#define SHORTEST 1e-4   /* share of the way to a sample, no unit; the way is lost where shorter steps fail */
#define PART 0.1        /* least share of the platform in the norm of K's inverse at the end of a branch, no unit: 1e-4 at a rank loss */
#define ITERATIONS 15   /* three times as many as quadratic convergence takes from LONGEST to SETTLED */

typedef struct {
  double q[NQ];
  double trig[2 * NT + 1]; /* cosine and sine of what turns, computed once a configuration */
  double lu[NP * NP + 1];
  int pivot[NP + 1];
  double sign; /* of the determinant of K in the order of its blocks: it changes across a type I singularity */
  double residual; /* largest residual, in characteristic lengths or rad */
} Pose;

static void rows(const double *numbers, const double *q, const double *trig, const double *x, double *residual, double *K, double *alignment) {
  const double *const arg[] = {q, trig, x, numbers};
  double *const res[] = {residual, K, alignment};
  rp_rows(arg, res);
}

/* K stands by blocks (ROW_PLACE and COLUMN_PLACE say where its rows and columns are): above those on its diagonal it is zero, as a leg's
   closures know nothing of the other legs. So it is decomposed, and solved, block by block (Davis and Natarajan, "KLU", 2010). EACH_BLOCK
   gives for each its place and size, and the end of the rows that its columns reach. Returns the sign of the determinant in this order,
   0 where it vanishes. */
#define ENTRY(i, j) (ROW_PLACE[i] + COLUMN_PLACE[j] * NP)

static double decompose_rows(double *K, int *pivot) {
  double sign = 1.0;
#define BLOCK(first, size, end) sign *= decompose(K + (first) * (NP + 1), size, pivot + (first));
  EACH_BLOCK
#undef BLOCK
  return sign;
}

static inline void solve_block(const double *K, const int *pivot, double *x, int first, int size, int end) {
  int any = 0;
  for (int j = first; j < first + size; ++j) any = any || x[j] != 0.0;
  if (!any) return;
  solve(K + first * (NP + 1), size, pivot + first, x + first);
  for (int j = first; j < first + size; ++j)
    for (int i = first + size; i < end; ++i) x[i] -= x[j] * K[i + j * NP];
}

/* x = K^-1 x, both in the order of the blocks. */
static void solve_blocks(const double *K, const int *pivot, double *x) {
#define BLOCK(first, size, end) solve_block(K, pivot, x, first, size, end);
  EACH_BLOCK
#undef BLOCK
}

/* b = K^-1 b */
static void solve_rows(const double *K, const int *pivot, double *b) {
  double x[NP + 1];
  for (int i = 0; i < NP; ++i) x[ROW_PLACE[i]] = b[i];
  solve_blocks(K, pivot, x);
  for (int i = 0; i < NP; ++i) b[i] = x[COLUMN_PLACE[i]];
}

static void bias_of(const double *numbers, const double *q, const double *trig, const double *v, double *bias) {
  const double *const arg[] = {q, trig, v, numbers};
  double *const res[] = {bias};
  rp_bias(arg, res);
}

/* Newton's method from q, to coordinates that miss x by left (N); returns whether each step was at most a ratio of the one before. */
APART int newton_by(double ratio, const double *numbers, const double *q, const double *x, const double *left, Pose *out) {
  double step[NP + 1], alignment[NALIGN], last = LONGEST / ratio;
  copy(out->q, q, NQ);
  for (int iteration = 0; iteration < ITERATIONS; ++iteration) {
    turns_of(out->q, out->trig);
    rows(numbers, out->q, out->trig, x, step, out->lu, alignment);
    if (left)
      for (int i = 0; i < N; ++i) step[R + i] -= left[i];
    out->residual = largest(step, NP);
    out->sign = decompose_rows(out->lu, out->pivot);
    if (out->sign == 0.0) return 0;
    solve_rows(out->lu, out->pivot, step);
    double size = largest(step, NP);
    int stalled = size > ratio * last && size <= FLOOR; /* at rounding, also where that is two units in the last place of a coordinate */
    int settled = size <= SETTLED || (stalled && (out->residual < TOLERANCE || size <= 2.0 * EPSILON * largest_over(out->q, POSITION_UNIT, NQ)));
    if (settled) {
      if (!left)
        for (int i = 0; i < NALIGN; ++i)
          if (!(alignment[i] > 0.0)) return 0;
      return 1;
    }
    if (!(size <= ratio * last)) return 0;
    for (int i = 0; i < NP; ++i) step[i] *= VELOCITY_UNIT[COLUMNS[i]];
    move(out->q, step);
    last = size;
  }
  return 0;
}

/* The same while it contracts. */
static int newton(const double *numbers, const double *q, const double *x, const double *left, Pose *out) {
  return newton_by(CONTRACTION, numbers, q, x, left, out);
}

/* From a closed pose to a goal, on the straight way (`size` numbers) there, in as many steps as Newton's method needs to contract. close
   brings a pose to the goal, of which it misses `left` (null: nothing), the determinant's sign kept, or does not move it. Returns
   STATUS_OK, or why the last step failed; the pose is then the last one on the way. */
static int follow_way(const double *numbers, Pose *pose, int (*close)(const double *, Pose *, const double *, const double *),
                      const double *goal, const double *way, int size) {
  double left[NV + 1], done = 0.0, share = 1.0;
  while (done < 1.0) {
    double ahead = done + share < 1.0 ? 1.0 - done - share : 0.0;
    for (int i = 0; i < size; ++i) left[i] = ahead * way[i];
    int failed = close(numbers, pose, goal, ahead > 0.0 ? left : 0);
    if (!failed) {
      done += share;
      share = fmin(2.0 * share, 1.0 - done);
    } else {
      share *= 0.5;
      if (share < SHORTEST) return failed;
    }
  }
  return STATUS_OK;
}

/* Whether a pivot is rounding, and the determinant of K has no sign that says anything. */
static int is_rounding(const Pose *pose) {
  for (int i = 0; i < NP; ++i)
    if (!(NP * EPSILON * fabs(pose->lu[i * (NP + 1)]) < 1.0)) return 1;
  return 0;
}

/* A way must not begin its next step at a singularity, on whose other side it could take the other branch. */
static int close_at(const double *numbers, Pose *pose, const double *x, const double *left) {
  Pose next;
  if (!newton(numbers, pose->q, x, left, &next) || next.sign != pose->sign || (left && is_rounding(&next))) return STATUS_UNREACHABLE;
  *pose = next;
  return STATUS_OK;
}

/* From a closed pose to the coordinates x, on the straight way there; returns whether it comes there. */
static int follow(const double *numbers, Pose *pose, const double *x) {
  double residual[NP + 1], K[NP * NP + 1], alignment[NALIGN];
  rows(numbers, pose->q, pose->trig, x, residual, K, alignment);
  return follow_way(numbers, pose, close_at, x, residual + R, N) == STATUS_OK;
}

/* --- whole turns: as in robot/whole_turns.py ----------------------------------------------------------------------- */

#if TURNS
/* Bring a pose so many turns of coordinate c on; at is moved along. A turn that brings all joints back, but for whole
   turns of their own, does so again. With gears several turns may pass until it does. */
static int go_round(const double *numbers, Pose *pose, double *at, int c, double count) {
  double first = at[c], step = copysign(TURN, count), left = fabs(count), followed = 0.0, start[NQ], shift[NQ];
  int known = 0;
  copy(start, pose->q, NQ);
  while (left > 0.0) {
    at[c] = first + (fabs(count) - left + 1.0) * step; /* a sum of thousands of steps would drift */
    if (!follow(numbers, pose, at)) return 0;
    left -= 1.0;
    followed += 1.0;
    if (followed > MOST_TURNS) return 0;
    if (known || left == 0.0) continue;
    int whole = 1;
    for (int j = 0; j < NQ; ++j) {
      double moved = pose->q[j] - start[j];
      shift[j] = ANGLE[j] ? TURN * round(moved / TURN) : 0.0;
      if (!(fabs(moved - shift[j]) < WHOLE * POSITION_UNIT[j])) whole = 0;
    }
    if (!whole) continue;
    double times = floor(left / followed);
    for (int j = 0; j < NQ; ++j) {
      double moved = pose->q[j] + times * shift[j];
      pose->q[j] = ANGLE[j] == 2 || fabs(moved) < EXACT ? moved : pose->q[j] - shift[j];
    }
    left -= times * followed;
    at[c] = first + (fabs(count) - left) * step;
    known = 1;
    if (close_at(numbers, pose, at, 0)) return 0;
  }
  return 1;
}
#endif

/* From a pose closed at here to the coordinates x, however many turns away. */
APART int go_far(const double *numbers, Pose *pose, const double *here, const double *x) {
#if TURNS
  static const int COUNTED[] = COUNTED_COORDINATES;
  double at[NX], count[TURNS];
  int far = 0;
  Pose next = *pose;
  copy(at, x, NX);
  for (int i = 0; i < TURNS; ++i) {
    if (!(fabs(x[COUNTED[i]]) <= FARTHEST)) return 0;
    count[i] = trunc((x[COUNTED[i]] - here[COUNTED[i]]) / TURN);
    at[COUNTED[i]] -= TURN * count[i];
    far = far || count[i] != 0.0;
  }
  if (far) {
    int there = follow(numbers, &next, at);
    for (int i = 0; i < TURNS; ++i) there = there && go_round(numbers, &next, at, COUNTED[i], count[i]);
    if (there && follow(numbers, &next, x)) {
      *pose = next;
      return 1;
    }
  }
  for (int i = 0; i < TURNS; ++i) {
    if (fabs(count[i]) > MOST_TURNS) return 0; /* the straight way would take as many steps, one by one */
  }
#else
  (void)here;
#endif
  return follow(numbers, pose, x);
}

/* A column of the inverse of K, in the order of the blocks; returns the sum of its squares. */
static double inverse_column(const Pose *pose, int column, double *x) {
  clear(x, NP);
  x[ROW_PLACE[column]] = 1.0;
  solve_blocks(pose->lu, pose->pivot, x);
  return dot(x, x, NP);
}

/* Γ (NV x N) and W (N x M) at a pose; returns the margin, one over the norm of the inverse of K. */
static double invert_pose(const double *numbers, const Pose *pose, double *gamma, double *W) {
  double size = 0.0, x[NP + 1];
  clear(gamma, NV * N);
  for (int j = 0; j < R; ++j) size += inverse_column(pose, j, x);
  for (int j = 0; j < N; ++j) {
    size += inverse_column(pose, R + j, x);
    for (int i = 0; i < NP; ++i) gamma[COLUMNS[i] * N + j] = x[COLUMN_PLACE[i]] * (VELOCITY_UNIT[COLUMNS[i]] / EQUATION_UNIT[R + j]);
  }
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < M; ++j) W[i * M + j] = gamma[ACTUATED[j] * N + i];
  return size > 0.0 ? 1.0 / sqrt(size) : INFINITY;
}

/* Velocity and acceleration of the tree at a closed pose, Γ, W and the margin; K v = (0, xd), K a = (0, xdd) - bias. */
static double rates(const double *numbers, const Pose *pose, const double *xd, const double *xdd, double *v, double *a, double *gamma, double *W) {
  double bias[NP + 1], margin = invert_pose(numbers, pose, gamma, W);
  clear(v, NV);
  clear(a, NV);
  for (int i = 0; i < NP; ++i) v[COLUMNS[i]] = dot(gamma + COLUMNS[i] * N, xd, N);
  bias_of(numbers, pose->q, pose->trig, v, bias);
  for (int i = 0; i < NP; ++i) bias[i] = ((i < R ? 0.0 : xdd[i - R]) - bias[i]) / EQUATION_UNIT[i];
  solve_rows(pose->lu, pose->pivot, bias);
  for (int i = 0; i < NP; ++i) a[COLUMNS[i]] = bias[i] * VELOCITY_UNIT[COLUMNS[i]];
  return margin;
}

static int in_mode(const double *numbers, const Pose *pose) {
  double sides[LEGS + 1] = {0.0};
  sides_of(numbers, pose->q, pose->trig, sides);
  for (int i = 0; i < LEGS; ++i)
    if (!(sides[i] > 0.0)) return 0;
  return 1;
}

/* Squares of the Frobenius norms of the inverse of K at a pose, and of its columns that belong to the platform. */
static void inverse_sizes(const Pose *pose, double *all, double *platform) {
  double x[NP + 1];
  *all = *platform = 0.0;
  for (int j = 0; j < NP; ++j) {
    double size = inverse_column(pose, j, x);
    *all += size;
    if (j >= R) *platform += size;
  }
}

/* Whether a pose is next to a rank loss of the closures: the platform then hardly has a part in what K cannot do, and a branch may go
   on beyond. At a leg that is stretched, or folded, it has one, and the branch ends. */
static int may_go_on(const Pose *pose) {
  double all, platform;
  inverse_sizes(pose, &all, &platform);
  return !(platform > PART * PART * all);
}

/* Whether coordinates are a homogeneous pose, as motion.PlatformMotion asks; all are where a robot has no poses. */
static int is_pose(const double *x) {
#if NX != N
  const double *const a = x, *const b = x + 4, *const c = x + 8, *const last = x + 12;
  double miss = fabs(a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]) - 1.0);
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) {
      const double *row = x + 4 * i, *other = x + 4 * j;
      miss = fmax(miss, fabs(row[0] * other[0] + row[1] * other[1] + row[2] * other[2] - (i == j)));
    }
  for (int i = 0; i < 4; ++i) miss = fmax(miss, fabs(last[i] - (i == 3)));
  return miss <= POSE_TOLERANCE;
#else
  (void)x;
  return 1;
#endif
}

/* Why a sample cannot be evaluated whatever the robot: STATUS_NOT_FINITE, STATUS_UNREACHABLE for a matrix that is no pose, or STATUS_OK. */
static int refusal_of(const double *in) {
  if (!finite(in, NX + 2 * N + 3 * NK + NWRENCH)) return STATUS_NOT_FINITE;
  return is_pose(in) ? STATUS_OK : STATUS_UNREACHABLE;
}

/* One sample: in = x, xd, xdd, s, sd, sdd, wrenches; out = W, f, carrier forces, residual, margin. state is where Newton starts, and
   afterwards where it ended: the configuration, and the determinant's sign (0: not known). Nothing is written unless the
   sample is closed on the same side of every type I singularity. Returns a status: STATUS_UNREACHABLE where Newton's method fails. */
APART int rp_sample(const double *numbers, double *state, const double *in, double *out) {
  const double *x = in, *xd = in + NX, *xdd = xd + N, *s = xdd + N;
  double v[NV], a[NV], gamma[NV * N + 1], W[N * M + 1], f[N + 1], force[NK + 1] = {0.0};
  Pose pose;
  int refused = refusal_of(in);
  if (refused) return refused;
  if (!newton(numbers, state, x, 0, &pose) || pose.sign * state[NQ] < 0.0) return STATUS_UNREACHABLE;
  double margin = rates(numbers, &pose, xd, xdd, v, a, gamma, W);
  if (margin < SINGULAR_MARGIN || (margin < ROUNDED_MARGIN && may_go_on(&pose))) return STATUS_TYPE_I;
  if (!in_mode(numbers, &pose)) return STATUS_BRANCH_LOST;
  const double *const arg[] = {pose.q, pose.trig, v, a, gamma, s, s + NK, s + 2 * NK, s + 3 * NK, numbers};
  double *const res[] = {f, force};
  rp_project(arg, res);
  if (!finite(f, N) || !finite(force, NK)) return STATUS_NOT_FINITE; /* rates so large that forces overflow */
  copy(state, pose.q, NQ);
  state[NQ] = pose.sign;
  copy(out, W, N * M);
  copy(out + N * M, f, N);
  copy(out + N * M + N, force, NK);
  out[N * M + N + NK] = pose.residual * LENGTH;
  out[N * M + N + NK + 1] = margin;
  return STATUS_OK;
}

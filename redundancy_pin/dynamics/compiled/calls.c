/* What Python calls for one sample: torques and joint states. It follows sample.c. A state is a configuration (NQ) and the sign
   of its determinant, 0 where unknown: where Newton's method starts, and afterwards where it ended. Not a number: a rank loss of the
   closures, from where kinematics go on. Calls return a status of redundancy_pin.status; only samples that are closed write their
   results and the state. */

/* A range of a joint or a track of a carrier (robot/joint_ranges.py): its index in q, whether whole turns count as none, its
   ends and slack. */
typedef struct {
  double at, turns, lower, upper, slack;
} Range;

#define MOST_SEARCHES 100 /* steps of Newton's method: half a turn of every joint takes some 50 */
#define FARTHEST_LOST 20.0 /* rad or characteristic lengths of an actuator, three turns: what is lost on a longer way is not looked for */
#define STALLED 10 /* steps of it; where so many reduce the residual by less than a tenth, no configuration is near */

enum { FOR_KINEMATICS = STATUSES };

static int in_ranges(const double *q, const Range *ranges, int count) {
  for (int i = 0; i < count; ++i) {
    const Range *range = ranges + i;
    double value = q[(int)range->at];
    if (range->turns != 0.0)
      value -= TURN * rint((value - 0.5 * (range->lower + range->upper)) / TURN);
    if (range->lower - value > range->slack || value - range->upper > range->slack) return 0;
  }
  return 1;
}

/* Start from a configuration (NQ). The signs (LEGS) of the working mode among the numbers of a call become those of the start, so that
   in_mode keeps its legs on their sides; declared are those of the robot's own numbers. Returns 0, and does nothing, where the start
   is not finite. */
int rp_begin(const double *numbers, const double *declared, const double *start, double *signs, double *state) {
  double trig[2 * NT + 1], sides[LEGS + 1] = {0.0};
  if (!finite(start, NQ)) return 0;
  turns_of(start, trig);
  sides_of(numbers, start, trig, sides);
  for (int i = 0; i < LEGS; ++i) signs[i] = declared[i] * ((sides[i] > 0.0) - (sides[i] < 0.0));
  copy(state, start, NQ);
  state[NQ] = 0.0;
  return 1;
}

/* Close the loops at a start, which may be open by the noise of measurements: so little that K stays regular on the way, as
   RneaDynamics has it. The distance moved proves the branch, so that Newton's steps need only shrink. Returns whether they close. */
static int close_start(const double *numbers, const double *start, Pose *pose, double *x) {
  double all, platform, moved = 0.0, trig[2 * NT + 1];
  if (!finite(start, NQ)) return 0;
  turns_of(start, trig);
  coordinates_of(numbers, start, trig, x);
  if (!newton_by(1.0, numbers, start, x, 0, pose)) return 0;
  inverse_sizes(pose->lu, pose->pivot, &all, &platform);
  for (int i = 0; i < NQ; ++i) moved = fmax(moved, fabs(pose->q[i] - start[i]) / POSITION_UNIT[i]);
  return moved * moved * all < 0.25; /* half of the margin, 1 / sqrt(all) */
}

/* What Newton's method solves at a configuration: residual (NP), its matrix, and alignment of hinges, for a goal of coordinates or
   actuators. */
typedef void Linearise(const double *numbers, const double *q, const double *trig, const double *goal, double *residual, double *K, double *alignment);

/* Where a goal is looked for by Newton's method with a line search; q is moved. It ends where steps no longer reduce the residual, at
   latest after MOST_SEARCHES. Returns STATUS_UNREACHABLE where the largest residual, without unit, is not zero; STATUS_OK where it is, at
   a regular configuration; and FOR_KINEMATICS where these decide whether it is: where the matrix is singular, next to a double root (a
   leg at full stretch), which rounding moves by the square root of the tolerance, and of a hinge the wrong way round. */
static int search(const double *numbers, Linearise *linearise, double *q, const double *goal, double *least) {
  double trig[2 * NT + 1], residual[NP + 1], step[NP + 1], part[NP + 1], K[NP * NP + 1], alignment[NALIGN], from[NQ];
  double before = INFINITY;
  int pivot[NP + 1];
  turns_of(q, trig);
  linearise(numbers, q, trig, goal, residual, K, alignment);
  for (int iteration = 0; iteration < MOST_SEARCHES; ++iteration) {
    double size = dot(residual, residual, NP), share = 1.0;
    if (iteration % STALLED == 0) {
      if (sqrt(size) > 0.9 * before) break;
      before = sqrt(size);
    }
    copy(step, residual, NP);
    copy(from, q, NQ);
    if (decompose(K, pivot) == 0.0) return FOR_KINEMATICS;
    solve(K, pivot, step);
    double longest = largest(step, NP);
    int last = longest <= FLOOR; /* a step of rounding is taken whole */
    int regular = 0;
    if (last) {
      double all, platform;
      inverse_sizes(K, pivot, &all, &platform);
      regular = all * NEAR_SINGULAR * NEAR_SINGULAR < 1.0;
    }
    for (share = fmin(1.0, LONGEST / longest); share > SHORTEST; share *= 0.5) {
      for (int i = 0; i < NP; ++i) part[i] = share * step[i] * VELOCITY_UNIT[COLUMNS[i]];
      copy(q, from, NQ);
      move(q, part);
      turns_of(q, trig);
      linearise(numbers, q, trig, goal, residual, K, alignment);
      if (last || dot(residual, residual, NP) < size) break;
    }
    if (!last && share > SHORTEST) continue;
    *least = largest(residual, NP);
    if (*least > TOLERANCE) return STATUS_UNREACHABLE;
    for (int i = 0; i < NALIGN; ++i)
      if (!(alignment[i] > 0.0)) return FOR_KINEMATICS;
    return regular ? STATUS_OK : FOR_KINEMATICS;
  }
  *least = largest(residual, NP);
  return *least > sqrt(TOLERANCE) ? STATUS_UNREACHABLE : FOR_KINEMATICS;
}

/* Whether a pose is turned so far from the coordinates x that the rows of its rotation, sines, do not say how to get there. */
static int turned_far(const double *numbers, const Pose *pose, const double *x) {
#if NX != N
  double here[NX], trace = 0.0;
  coordinates_of(numbers, pose->q, pose->trig, here);
  for (int i = 0; i < 3; ++i) trace += dot(here + 4 * i, x + 4 * i, 3);
  return trace < 1.0 + 2.0 * cos(LONGEST);
#else
  (void)numbers, (void)pose, (void)x;
  return 0;
#endif
}

static void keep(const Pose *pose, double *state) {
  copy(state, pose->q, NQ);
  state[NQ] = pose->sign;
}

/* The configuration from which a call goes on, in reached: that of the state, or of a start, whose chains have to close and whose sign
   of the determinant is not known yet. Returns STATUS_BRANCH_LOST where they do not. */
static int begin_at(const double *numbers, const double *state, double *reached) {
  double x[NX];
  Pose pose;
  copy(reached, state, NQ + 1);
  if (state[NQ] != 0.0) return STATUS_OK;
  if (!close_start(numbers, state, &pose, x)) return STATUS_BRANCH_LOST;
  keep(&pose, reached);
  return STATUS_OK;
}

/* A sample that is more than one step of Newton's method away, by the branch of a closed state, on the straight way, however many turns
   away. Afterwards reached is the last configuration on the way, or the first next to a rank loss; from is the sample's. Returns as
   rp_reach. */
static int follow_to(const double *numbers, double *reached, double *from, const double *in, double *out) {
  double here[NX];
  Pose pose;
  if (pose_at(numbers, reached, reached[NQ], &pose, here)) return STATUS_BRANCH_LOST;
  if (go_far(numbers, &pose, here, in)) {
    keep(&pose, from);
    int closed = rp_sample(numbers, from, in, out);
    return closed == STATUS_UNREACHABLE ? STATUS_BRANCH_LOST : closed;
  }
  int bifurcation = may_go_on(&pose);
  if (!bifurcation) keep(&pose, reached); /* the tangent, by which kinematics pass, is known better where the way began */
  double residual = 0.0;
  if (bifurcation || turned_far(numbers, &pose, in) || search(numbers, rows, pose.q, in, &residual) != STATUS_UNREACHABLE)
    return STATUS_BRANCH_LOST;
  out[N * M + N + NK] = residual * LENGTH;
  return STATUS_UNREACHABLE;
}

/* One sample; in and out as rp_sample, on the branch of the state. The state is moved where the sample is closed; reached, of the same
   size, is where kinematics go on. Returns a status: STATUS_UNREACHABLE where the loops close nowhere, the closure residual is then
   among out, and of a matrix that is no pose; STATUS_BRANCH_LOST where they may close. */
int rp_reach(const double *numbers, double *state, double *reached, const double *in, double *out) {
  double from[NQ + 1];
  int refused = refusal_of(in);
  if (!refused) refused = begin_at(numbers, state, reached);
  if (refused) return refused;
  if (isnan(state[NQ])) return STATUS_BRANCH_LOST;
  copy(from, reached, NQ + 1);
  int closed = rp_sample(numbers, from, in, out);
  if (closed == STATUS_UNREACHABLE) closed = follow_to(numbers, reached, from, in, out);
  if (closed == STATUS_OK) copy(state, from, NQ + 1);
  return closed;
}

#if M
/* Torques of one sample. out: as rp_sample, then tau (M) and the type II margin. Returns a status. */
int rp_torque(const double *numbers, double *state, double *reached, const double *in, double *out, const Range *ranges, int count) {
  double q[NQ], *const f = out + N * M, *const tau = f + N + NK + 2;
  Efforts efforts;
  int closed = rp_reach(numbers, state, reached, in, out);
  if (closed) return closed;
  int status = distribute(numbers, out, f, force_size_of(numbers, in), &efforts);
  if (status == STATUS_NOT_FINITE) { /* efforts overflow: a sample without results moves no state */
    copy(state, reached, NQ + 1);
    return status;
  }
  copy(tau, efforts.tau, M);
  tau[M] = efforts.margin;
  if (status > STATUS_SINGULAR_CONSISTENT) return status;
  copy(q, state, NQ);
  for (int i = 0; i < NK; ++i) q[CARRIED[i]] = in[NX + 2 * N + i];
  return in_ranges(q, ranges, count) ? status : STATUS_OUT_OF_RANGE;
}
#endif

#if M && M >= N
static void recall(const double *state, Pose *pose) {
  copy(pose->q, state, NQ);
  turns_of(pose->q, pose->trig);
  pose->sign = state[NQ];
}

static int close_drives(const double *numbers, Pose *pose, const double *position, const double *left) {
  double off[M];
  Pose next = *pose;
  int status = forward(numbers, &next, position, left, off);
  if (status == STATUS_OK) *pose = next;
  return status;
}

/* Moves a pose to where its actuators are at the given positions, on the straight way of the actuators. Returns a status. */
static int follow_drives(const double *numbers, Pose *pose, const double *position) {
  double way[M];
  drives(pose->q, position, way);
  int status = follow_way(numbers, pose, close_drives, position, way, M);
  return status == STATUS_OK || status == STATUS_TYPE_II ? status : STATUS_BRANCH_LOST;
}

/* Whether positions of the actuators are so far from a configuration that nothing more is done about a way that is lost. */
static int is_far(const double *numbers, const double *q, const double *position) {
  double way[M];
  drives(q, position, way);
  for (int j = 0; j < M; ++j)
    if (!(fabs(way[j]) <= FARTHEST_LOST * VELOCITY_UNIT[ACTUATED[j]])) return 1;
  return 0;
}

#if M == N
/* What Newton's method solves for closures and positions of as many actuators as DOF, as rows. */
static void driven_rows(const double *numbers, const double *q, const double *trig, const double *position, double *residual, double *A, double *alignment) {
  double x[NX], off[M];
  coordinates_of(numbers, q, trig, x);
  rows(numbers, q, trig, x, residual, A, alignment);
  drives(q, position, off);
  drive_rows(numbers, off, A, residual);
}

/* As close_drives, on either side of type I singularities. */
static int close_either_side(const double *numbers, Pose *pose, const double *position, const double *left) {
  double sign = pose->sign;
  pose->sign = 0.0;
  int status = close_drives(numbers, pose, position, left);
  if (status) pose->sign = sign;
  return status;
}

/* Why positions of the actuators are not reached, whose way ends at a pose. Next to a rank loss of the closures kinematics decide, from
   reached as it is. At a type I singularity they go on, where the way beyond leads to the positions: K is next to singular there,
   [J_c; S] is not. Returns STATUS_UNREACHABLE, with the residual in m; STATUS_BRANCH_LOST; or FOR_KINEMATICS. */
static int lost_drives(const double *numbers, const Pose *pose, const double *position, double *reached, double *residual) {
  double all, driven, platform, q[NQ], x[NX], rest[NP + 1], alignment[NALIGN], least = 0.0;
  Pose own = *pose, other = *pose;
  coordinates_of(numbers, pose->q, pose->trig, x);
  rows(numbers, pose->q, pose->trig, x, rest, own.lu, alignment);
  driven_rows(numbers, pose->q, pose->trig, position, rest, other.lu, alignment);
  if (decompose(own.lu, own.pivot) == 0.0 || decompose(other.lu, other.pivot) == 0.0) return FOR_KINEMATICS;
  inverse_sizes(own.lu, own.pivot, &all, &platform);
  inverse_sizes(other.lu, other.pivot, &driven, &platform);
  if (may_go_on(&own) || !(driven * SINGULAR_MARGIN * SINGULAR_MARGIN < 1.0)) return FOR_KINEMATICS;
  keep(pose, reached);
  if (2.0 * driven < all) {
    double way[M];
    drives(pose->q, position, way);
    own = *pose;
    if (follow_way(numbers, &own, close_either_side, position, way, M) == STATUS_OK) return FOR_KINEMATICS;
  }
  copy(q, own.q, NQ);
  int found = search(numbers, driven_rows, q, position, &least);
  if (found == STATUS_UNREACHABLE) *residual = least * LENGTH;
  return found == STATUS_OK ? STATUS_BRANCH_LOST : found;
}
#endif

/* Whether velocities (M) of the actuators, more than DOF, are those of one motion of the platform, relative to the terms that cancel. */
static int velocities_agree(const double *numbers, const Platform *platform, const double *velocity) {
  double missing = 0.0, size = 0.0;
  for (int j = 0; j < M; ++j) {
    const double *row = platform->gamma + ACTUATED[j] * N;
    missing = fmax(missing, fabs(dot(row, platform->xd, N) - velocity[j]) * COLUMN_SCALE[j]);
    for (int i = 0; i < N; ++i) size = fmax(size, fabs(row[i] * platform->xd[i]) * COLUMN_SCALE[j]);
  }
  return missing <= AGREEMENT * size;
}

/* All joints and the platform from the actuators. in: positions (M) and velocities (M) of the actuators, s (NK), sd (NK); out:
   q (NQ), v (NV), x (NX), xd (N), type II margin, residual. More actuators than DOF may contradict each other: the residual of positions,
   m, is then written, and the status is unreachable. State and reached are as of rp_reach. Returns a status, or FOR_KINEMATICS where
   these may go on from reached, or from the state at a rank loss of the closures, or say what is singular. */
int rp_joint_state(const double *numbers, double *state, double *reached, const double *in, double *out, const Range *ranges, int count) {
  const double *position = in, *velocity = in + M, *s = velocity + M, *sd = s + NK;
  double *q = out, *v = q + NQ;
  Pose pose;
#if M == N
  Pose last;
#endif
  Platform platform;
  if (!finite(in, 2 * M + 2 * NK)) return STATUS_NOT_FINITE;
  if (begin_at(numbers, state, reached)) return STATUS_BRANCH_LOST;
  if (isnan(state[NQ])) return is_far(numbers, state, position) ? STATUS_BRANCH_LOST : FOR_KINEMATICS;
  recall(reached, &pose);
  int status = platform_of(numbers, &pose, position, velocity, &platform);
  int there = status != STATUS_UNREACHABLE && status != STATUS_TYPE_II;
  if (!there) { /* too far for one step of Newton's method */
    recall(reached, &pose);
    status = follow_drives(numbers, &pose, position);
#if M == N
    last = pose;
#endif
    there = !status;
    if (there) status = platform_of(numbers, &pose, position, velocity, &platform);
  }
  if (status == STATUS_NOT_FINITE) return status;
  if (status != STATUS_OK && status != STATUS_NEAR_SINGULAR) {
#if M == N
    if (is_far(numbers, reached, position)) return STATUS_BRANCH_LOST;
    return there ? FOR_KINEMATICS : lost_drives(numbers, &last, position, reached, v + NV + NX + N + 1);
#else
    return status;
#endif
  }
  copy(q, pose.q, NQ);
  clear(v, NV);
  for (int i = 0; i < NV; ++i)
    for (int j = 0; j < N; ++j) v[i] += platform.gamma[i * N + j] * platform.xd[j];
  for (int i = 0; i < NK; ++i) q[CARRIED[i]] = s[i], v[CARRIERS[i]] = sd[i];
  if (!finite(v, NV)) return STATUS_NOT_FINITE;
  v[NV + NX + N] = platform.margin;
  v[NV + NX + N + 1] = fmax(platform.residual, platform.mismatch);
  if (M > N && (platform.mismatch > AGREEMENT * LENGTH || !velocities_agree(numbers, &platform, velocity))) return STATUS_UNREACHABLE;
  copy(v + NV, platform.x, NX);
  copy(v + NV + NX, platform.xd, N);
  keep(&pose, state);
  return in_ranges(q, ranges, count) ? status : STATUS_OUT_OF_RANGE;
}
#endif

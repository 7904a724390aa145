/* What Python calls for one sample: torques and joint states. It follows sample.c. A state is a configuration (NQ) and the sign
   of its determinant, 0 where unknown: where Newton's method starts, and afterwards where it ended. Not a number: a rank loss of the
   closures, from where kinematics go on. Calls return a status of redundancy_pin.status, or FOR_KINEMATICS where the branch of the
   state is not followed to the sample: kinematics follow it, or say why it ends. Only samples that are closed write their results and
   move the state along the branch. */

/* A range of a joint or a track of a carrier (robot/joint_ranges.py): its index in q, whether whole turns count as none, its
   ends and slack. */
typedef struct {
  double at, turns, lower, upper, slack;
} Range;

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

static void keep(const Pose *pose, double *state) {
  copy(state, pose->q, NQ);
  state[NQ] = pose->sign;
}

/* Close the loops where the state is a start, whose sign of the determinant is not known yet. It may be open by the noise of
   measurements: so little that K stays regular on the way, as RneaDynamics has it. The distance moved proves the branch, so that
   Newton's steps need only shrink. Returns whether they close, away from singularities. */
APART int begin_at(const double *numbers, double *state) {
  double all, platform, moved = 0.0, x[NX], trig[2 * NT + 1];
  Pose pose;
  if (state[NQ] != 0.0) return 1;
  turns_of(state, trig);
  coordinates_of(numbers, state, trig, x);
  if (!newton_by(1.0, numbers, state, x, 0, &pose)) return 0;
  inverse_sizes(&pose, &all, &platform);
  for (int i = 0; i < NQ; ++i) moved = fmax(moved, fabs(pose.q[i] - state[i]) / POSITION_UNIT[i]);
  if (!(fmax(4.0 * moved * moved, SINGULAR_MARGIN * SINGULAR_MARGIN) * all < 1.0)) return 0; /* the margin is 1 / sqrt(all) */
  keep(&pose, state);
  return 1;
}

/* One sample; in and out as rp_sample, on the branch of the state: by one step of Newton's method, or on the straight way, however many
   turns away. There (NQ + 1) is where it ended. Returns a status: STATUS_OK; STATUS_NOT_FINITE; STATUS_BRANCH_LOST where the state is a
   start that does not close; or why the branch ends, plus FOR_KINEMATICS, also of a matrix that is no pose. */
static int reach(const double *numbers, double *state, double *there, const double *in, double *out) {
  double here[NX];
  Pose pose;
  int status = refusal_of(in);
  if (status) return status == STATUS_NOT_FINITE ? status : FOR_KINEMATICS + status;
  if (!begin_at(numbers, state)) return STATUS_BRANCH_LOST;
  if (isnan(state[NQ])) return FOR_KINEMATICS + STATUS_BRANCH_LOST;
  copy(there, state, NQ + 1);
  status = rp_sample(numbers, there, in, out);
  if (status == STATUS_UNREACHABLE && !pose_at(numbers, state, state[NQ], &pose, here) && go_far(numbers, &pose, here, in)) {
    keep(&pose, there);
    status = rp_sample(numbers, there, in, out);
  }
  return status == STATUS_OK || status == STATUS_NOT_FINITE ? status : FOR_KINEMATICS + status;
}

int rp_reach(const double *numbers, double *state, const double *in, double *out) {
  double there[NQ + 1];
  int status = reach(numbers, state, there, in, out);
  if (status == STATUS_OK) copy(state, there, NQ + 1);
  return status < FOR_KINEMATICS ? status : FOR_KINEMATICS;
}

#if M
/* Torques of one sample. out: as rp_sample, then tau (M) and the type II margin. Returns as reach, or the status of the efforts. */
static int torque(const double *numbers, double *state, const double *in, double *out, const Range *ranges, int count) {
  double there[NQ + 1], *const f = out + N * M, *const tau = f + N + NK + 2;
  Efforts efforts;
  int closed = reach(numbers, state, there, in, out);
  if (closed) return closed;
  int status = distribute(numbers, out, f, force_size_of(numbers, in), &efforts);
  if (status == STATUS_NOT_FINITE) return status; /* efforts overflow */
  copy(state, there, NQ + 1);
  copy(tau, efforts.tau, M);
  tau[M] = efforts.margin;
  if (status > STATUS_SINGULAR_CONSISTENT) return status;
  for (int i = 0; i < NK; ++i) there[CARRIED[i]] = in[NX + 2 * N + i];
  return in_ranges(there, ranges, count) ? status : STATUS_OUT_OF_RANGE;
}

int rp_torque(const double *numbers, double *state, const double *in, double *out, const Range *ranges, int count) {
  int status = torque(numbers, state, in, out, ranges, count);
  return status < FOR_KINEMATICS ? status : FOR_KINEMATICS;
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
   m, is then written, and the status is unreachable. Returns a status, or FOR_KINEMATICS where these may follow the actuators farther, or
   say what is singular: of as many actuators as DOF. */
int rp_joint_state(const double *numbers, double *state, const double *in, double *out, const Range *ranges, int count) {
  const double *position = in, *velocity = in + M, *s = velocity + M, *sd = s + NK;
  double *q = out, *v = q + NQ;
  Pose pose;
  Platform platform;
  if (!finite(in, 2 * M + 2 * NK)) return STATUS_NOT_FINITE;
  if (!begin_at(numbers, state)) return STATUS_BRANCH_LOST;
  if (isnan(state[NQ])) return FOR_KINEMATICS;
  recall(state, &pose);
  int status = platform_of(numbers, &pose, position, velocity, &platform);
  if (status == STATUS_UNREACHABLE || status == STATUS_TYPE_II) { /* too far for one step of Newton's method */
    recall(state, &pose);
    status = follow_drives(numbers, &pose, position);
    if (!status) status = platform_of(numbers, &pose, position, velocity, &platform);
  }
  if (status == STATUS_NOT_FINITE) return status;
  if (status != STATUS_OK && status != STATUS_NEAR_SINGULAR) return M == N ? (int)FOR_KINEMATICS : status;
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

/* What Python calls for one sample: torques and joint states. It follows sample.c. A state is a configuration (NQ) and the sign
   of its determinant, 0 where unknown: where Newton's method starts, and afterwards where it ended. Calls return a status of
   redundancy_pin.status; only samples that are closed write their results and the state. */

/* A range of a joint or a track of a carrier (robot/joint_ranges.py): its index in q, whether whole turns count as none, its
   ends and slack. */
typedef struct {
  double at, turns, lower, upper, slack;
} Range;

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

/* The sides of the legs (LEGS) at a configuration, as sides_of. */
void rp_sides(const double *numbers, const double *q, double *sides) {
  double trig[2 * NT + 1];
  turns_of(q, trig);
  sides_of(numbers, q, trig, sides);
}

/* One sample; in and out as rp_sample. Where Newton's method does not get there in one step, the branch of the state is followed, on the
   straight way, however many turns away. The state is moved where the sample is closed; reached, of the same size, is the last
   configuration on the way. Returns a status of the driver. */
int rp_reach(const double *numbers, double *state, double *reached, const double *in, double *out) {
  double here[NX];
  Pose pose;
  copy(reached, state, NQ + 1);
  int closed = rp_sample(numbers, reached, in, out);
  if (closed == LOST && pose_at(numbers, reached, reached[NQ], &pose, here) == STATUS_OK) {
    int there = go_far(numbers, &pose, here, in);
    copy(reached, pose.q, NQ);
    reached[NQ] = pose.sign;
    if (there) closed = rp_sample(numbers, reached, in, out);
  }
  if (closed == CLOSED) copy(state, reached, NQ + 1);
  return closed;
}

#if M
enum { STATUS_NO_POSE = STATUSES };

/* Torques of one sample. out: as rp_sample, then tau (M), residual, margin, condition. Returns a status, or STATUS_NO_POSE. */
int rp_torque(const double *numbers, double *state, double *reached, const double *in, double *out, const Range *ranges, int count) {
  double q[NQ], *const f = out + N * M, *const tau = f + N + NK + 2;
  Efforts efforts;
  int closed = rp_reach(numbers, state, reached, in, out);
  if (closed == NO_POSE) return STATUS_NO_POSE;
  if (closed != CLOSED) return closed == LOST ? STATUS_BRANCH_LOST : status_of(closed);
  int status = distribute(numbers, out, f, force_size_of(numbers, in), &efforts);
  if (status == STATUS_NOT_FINITE) return status;
  copy(tau, efforts.tau, M);
  tau[M] = efforts.residual;
  tau[M + 1] = efforts.margin;
  tau[M + 2] = efforts.condition;
  if (status > STATUS_SINGULAR_CONSISTENT) return status;
  copy(q, state, NQ);
  for (int i = 0; i < NK; ++i) q[CARRIED[i]] = in[NX + 2 * N + i];
  return in_ranges(q, ranges, count) ? status : STATUS_OUT_OF_RANGE;
}
#endif

#if M && M >= N
/* Moves a pose to where its actuators are at the given positions, on the straight way of the actuators, in as many steps as
   Newton's method needs to contract. Returns a status. */
static int follow_drives(const double *numbers, Pose *pose, const double *position) {
  double left[M], target[M], off[M], done = 0.0, share = 1.0;
  drives(pose->q, position, left);
  while (done < 1.0) {
    Pose next = *pose;
    double ahead = done + share < 1.0 ? 1.0 - done - share : 0.0;
    for (int j = 0; j < M; ++j) target[j] = position[j] - ahead * left[j];
    int status = forward(numbers, &next, target, off);
    if (status == STATUS_OK) {
      *pose = next;
      done += share;
      share = fmin(2.0 * share, 1.0 - done);
    } else {
      share *= 0.5;
      if (share < SHORTEST) return status == STATUS_TYPE_II ? status : STATUS_BRANCH_LOST;
    }
  }
  return STATUS_OK;
}

/* All joints and the platform from the actuators. in: positions (M) and velocities (M) of the actuators, s (NK), sd (NK); out:
   q (NQ), v (NV), x (NX), xd (N), singularity margin, closure residual, mismatch of the actuators (M > N). */
int rp_joint_state(const double *numbers, double *state, const double *in, const Range *ranges, int count, double *out) {
  const double *position = in, *velocity = in + M, *s = velocity + M, *sd = s + NK;
  double x[NX], *q = out, *v = q + NQ, *last = v + NV + NX + N;
  Pose pose;
  Platform platform;
  if (!finite(in, 2 * M + 2 * NK)) return STATUS_NOT_FINITE;
  copy(pose.q, state, NQ);
  turns_of(pose.q, pose.trig);
  pose.sign = state[NQ];
  int status = pose.sign == 0.0 ? pose_at(numbers, state, 0.0, &pose, x) : STATUS_OK; /* its sign is known once it was closed */
  if (status) return status;
  Pose start = pose;
  status = platform_of(numbers, &pose, position, velocity, &platform);
  if (status == STATUS_UNREACHABLE || status == STATUS_TYPE_II) { /* too far for one step of Newton's method */
    pose = start;
    status = follow_drives(numbers, &pose, position);
    if (status) return status;
    status = platform_of(numbers, &pose, position, velocity, &platform);
  }
  if (status != STATUS_OK && status != STATUS_NEAR_SINGULAR) return status;
  copy(q, pose.q, NQ);
  clear(v, NV);
  for (int i = 0; i < NV; ++i)
    for (int j = 0; j < N; ++j) v[i] += platform.gamma[i * N + j] * platform.xd[j];
  for (int i = 0; i < NK; ++i) q[CARRIED[i]] = s[i], v[CARRIERS[i]] = sd[i];
  if (!finite(v, NV)) return STATUS_NOT_FINITE;
  copy(v + NV, platform.x, NX);
  copy(v + NV + NX, platform.xd, N);
  last[0] = platform.margin;
  last[1] = platform.gap;
  last[2] = platform.mismatch;
  copy(state, pose.q, NQ);
  state[NQ] = pose.sign;
  return in_ranges(q, ranges, count) ? status : STATUS_OUT_OF_RANGE;
}
#endif

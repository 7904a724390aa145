/* What a controller calls; see the header. This text follows driver.c, the tables of one robot and sample.c; robot_ and
   ROBOT_ in it become the prefix. Nothing is static but constants, nothing is allocated, every loop has a bound. */

/* --- states -------------------------------------------------------------------------------------------------------- */

static int pose_of(const robot_state *state, Pose *pose, double *x) { return pose_at(NUMBERS, state->q, state->sign, pose, x); }

static void store(const Pose *pose, robot_state *state) {
  copy(state->q, pose->q, NQ);
  state->sign = pose->sign;
}

int robot_reset(robot_state *state) {
  robot_state home;
  Pose pose;
  double x[NX];
  copy(home.q, REFERENCE, NQ);
  home.sign = 0.0;
  int status = pose_of(&home, &pose, x);
  if (status) return status;
  store(&pose, state);
  return ROBOT_OK;
}

int robot_go_to(robot_state *state, const double x[ROBOT_NX]) {
  Pose pose;
  double here[NX];
  if (!finite(x, NX)) return ROBOT_NOT_FINITE;
  int status = pose_of(state, &pose, here);
  if (status) return status;
  if (!go_far(NUMBERS, &pose, here, x)) return ROBOT_UNREACHABLE;
  if (!in_mode(NUMBERS, &pose)) return ROBOT_BRANCH_LOST;
  store(&pose, state);
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
  if (!finite(from, NQ + 1)) return ROBOT_NOT_FINITE;
  int status = rp_sample(NUMBERS, from, in, out);
  if (status) return status;
  if (!finite(out, N * M + N + NK + 2)) return ROBOT_NOT_FINITE; /* rates so large that forces overflow */
  Efforts found;
  status = distribute(NUMBERS, W, f, force_size_of(NUMBERS, in), &found);
  if (status == ROBOT_NOT_FINITE) return status;
  copy(efforts->tau, found.tau, M);
  efforts->residual = found.residual;
  efforts->margin = found.margin;
  efforts->condition = found.condition;
  efforts->rank = found.rank;
  copy(state->q, from, NQ);
  state->sign = from[NQ];
  for (int i = 0; i < N; ++i) copy(efforts->W[i], W + i * M, M);
  copy(efforts->f, f, N);
#if NK
  copy(efforts->carrier_force, rest, NK);
#endif
  efforts->closure_residual = rest[NK];
  efforts->type_I_margin = rest[NK + 1];
  return status;
}

/* --- forward kinematics -------------------------------------------------------------------------------------------- */

#if M >= N
int robot_forward_kinematics(robot_state *state, const robot_drives *given, robot_platform *platform) {
  Pose pose;
  Platform found;
  double x[NX];
  if (!finite(given->position, M) || !finite(given->velocity, M)) return ROBOT_NOT_FINITE;
  int status = pose_of(state, &pose, x);
  if (status) return status;
  status = platform_of(NUMBERS, &pose, given->position, given->velocity, &found);
  if (status != ROBOT_OK && status != ROBOT_NEAR_SINGULAR) return status;
  store(&pose, state);
  copy(platform->x, found.x, NX);
  copy(platform->xd, found.xd, N);
  platform->mismatch = found.mismatch;
  platform->closure_residual = found.residual;
  platform->margin = found.margin;
  platform->type_I_margin = found.type_I_margin;
  return status;
}
#endif

/* --- Jacobians and margins ----------------------------------------------------------------------------------------- */

int robot_jacobians_at(const robot_state *state, robot_jacobians *out) {
  Pose pose;
  double x[NX], gamma[NV * N], W[N * M];
  int status = pose_of(state, &pose, x);
  if (status) return status;
  if (!(invert_pose(NUMBERS, &pose, gamma, W) >= SINGULAR_MARGIN)) return ROBOT_TYPE_I;
#if R
  const double *const numbers = NUMBERS; /* by which the macros of units read */
  double residual[NP + 1], K[NP * NP + 1], alignment[NALIGN];
  rows(NUMBERS, pose.q, pose.trig, x, residual, K, alignment);
  clear(&out->closure[0][0], R * NV);
  for (int i = 0; i < R; ++i)
    for (int j = 0; j < NP; ++j) out->closure[i][COLUMNS[j]] = K[ENTRY(i, j)] * (EQUATION_UNIT[i] / VELOCITY_UNIT[COLUMNS[j]]);
#endif
  for (int i = 0; i < NV; ++i) copy(out->gamma[i], gamma + i * N, N);
  for (int i = 0; i < N; ++i) copy(out->W[i], W + i * M, M);
  return ROBOT_OK;
}

int robot_margins_at(const robot_state *state, robot_margins *out) {
  Pose pose;
  Spectrum s;
  double x[NX], gamma[NV * N], W[N * M];
  int status = pose_of(state, &pose, x);
  if (status) return status;
  double margin = invert_pose(NUMBERS, &pose, gamma, W);
  spectrum_of(NUMBERS, W, &s);
  if (!(margin >= SINGULAR_MARGIN)) return ROBOT_TYPE_I;
  out->type_I = margin;
  out->type_II = s.margin;
  out->condition = s.condition;
  out->rank = s.rank;
  return ROBOT_OK;
}

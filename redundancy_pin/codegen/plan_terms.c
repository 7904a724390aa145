/* --- for the planner: the dynamics at instants of a preview, each batch followed from those before ------------------ */

int robot_plan_begin(double *near, const double *x);
int robot_plan_terms(const double *numbers, int samples, const double *in, int width, double *near, double *out, double *sizes);

int robot_plan_begin(double *near, const double *x) {
  robot_state state;
  int status = robot_reset(&state);
  if (status == ROBOT_OK) status = robot_go_to(&state, x);
  if (status != ROBOT_OK) return status;
  for (int i = 0; i < NEIGHBOURS * (NQ + NX); ++i) near[i] = NAN;
  copy(near, state.q, NQ);
  copy(near + NQ, x, NX);
  return ROBOT_OK;
}

/* Follow the straight way from the nearest configuration to x, which is too far for Newton's method alone: of another preview, or of
   one at another speed. */
static int bring_near(double *near, const double *x) {
  Pose pose;
  double here[NX], *nearest = 0;
  for (int r = 0; r < NEIGHBOURS; ++r) {
    double *other = near + r * (NQ + NX);
    if (!isnan(other[0]) && (!nearest || distance(other + NQ, x, NX) < distance(nearest + NQ, x, NX))) nearest = other;
  }
  if (!nearest || pose_at(NUMBERS, nearest, 0.0, &pose, here) || !follow(NUMBERS, &pose, x)) return 0;
  copy(near, pose.q, NQ);
  copy(near + NQ, x, NX);
  return 1;
}

int robot_plan_terms(const double *numbers, int samples, const double *in, int width, double *near, double *out, double *sizes) {
  (void)numbers;
  int closed = rp_terms(NUMBERS, samples, in, width, near, out, sizes);
  return closed || !bring_near(near, in + 1) ? closed : rp_terms(NUMBERS, samples, in, width, near, out, sizes);
}

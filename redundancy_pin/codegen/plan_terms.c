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

int robot_plan_terms(const double *numbers, int samples, const double *in, int width, double *near, double *out, double *sizes) {
  (void)numbers;
  return rp_terms(NUMBERS, samples, in, width, near, out, sizes);
}

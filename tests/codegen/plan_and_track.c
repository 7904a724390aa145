/* A controller without Python: a planner at 200 Hz and a tracking controller at 1 kHz lead the 2-RPR of a MuJoCo model through a type II
   singularity, with what `redundancy-pin codegen --online --prefix unit` and `rp.write_mjcf` wrote.

   The platform goes from one side of the line of singular poses to the other and rests there. Every millisecond the controller takes
   the planner's carriers, efforts and forces, and adds feedback: of the platform's error through a damped inverse of W, which is
   singular on the way, and of each carrier's.

   usage: plan_and_track model.xml; prints the largest distance from the path, m, and how often det W changed its sign. */

#include "unit.h"

#include <math.h>
#include <mujoco/mujoco.h>
#include <stdio.h>

enum { N = UNIT_N, M = UNIT_M, K = UNIT_K, NV = UNIT_NV, COLUMNS = 3 * UNIT_N, ORDER = 6 };

#define DURATION 0.8                                          /* s, of the motion; half a second of rest follows */
static const double FROM[N] = {0.20, 0.12}, TO[N] = {0.30, -0.10}; /* m */
static const double STIFFNESS = 4e3, DAMPING = 80.0;          /* of the platform, N/m and N s/m: masses of about 1 kg at 60 rad/s */
static const double HOLD = 4e3, SLOW = 80.0;                  /* of a carrier, N/m and N s/m */
static const double DAMPED = 0.1;                             /* singular value of W below which it is not inverted */
static const double CORRECTION = 0.2;                         /* share of a carrier's distance from its plan that the next one takes over */

/* x = FROM + (TO - FROM) (10 u^3 - 15 u^4 + 6 u^5), u = t / DURATION, with its rates: powers of t, the highest first. */
static void set_path(double coefficients[ORDER][COLUMNS]) {
  static const double shape[ORDER] = {6.0, -15.0, 10.0, 0.0, 0.0, 0.0};
  for (int d = 0; d < ORDER; ++d)
    for (int i = 0; i < N; ++i) {
      int power = ORDER - 1 - d;
      double way = TO[i] - FROM[i], c = way * shape[d] / pow(DURATION, power);
      coefficients[d][i] = c + (power == 0 ? FROM[i] : 0.0);
      if (d + 1 < ORDER) coefficients[d + 1][N + i] = power * c;
      if (d + 2 < ORDER) coefficients[d + 2][2 * N + i] = power * (power - 1) * c;
    }
  for (int i = 0; i < N; ++i) coefficients[0][N + i] = coefficients[0][2 * N + i] = coefficients[1][2 * N + i] = 0.0;
}

static void at(double coefficients[ORDER][COLUMNS], double t, unit_motion *motion) {
  double value[COLUMNS] = {0}, inside = t < DURATION ? t : DURATION;
  for (int d = 0; d < ORDER; ++d)
    for (int c = 0; c < COLUMNS; ++c) value[c] = value[c] * inside + coefficients[d][c];
  for (int i = 0; i < N; ++i) {
    motion->x[i] = value[i];
    motion->xd[i] = t < DURATION ? value[N + i] : 0.0;
    motion->xdd[i] = t < DURATION ? value[2 * N + i] : 0.0;
  }
}

/* The platform's error from those of all joints, by least squares over Gamma; N is 2. */
static void platform_error(double gamma[NV][N], const double *joints, double *error) {
  double a = 0.0, b = 0.0, c = 0.0, right[N] = {0};
  for (int v = 0; v < NV; ++v) {
    a += gamma[v][0] * gamma[v][0], b += gamma[v][0] * gamma[v][1], c += gamma[v][1] * gamma[v][1];
    for (int i = 0; i < N; ++i) right[i] += gamma[v][i] * joints[v];
  }
  error[0] = (c * right[0] - b * right[1]) / (a * c - b * b);
  error[1] = (a * right[1] - b * right[0]) / (a * c - b * b);
}

/* Wᵀ (W Wᵀ + damped² I)⁻¹ f. */
static void damped_efforts(double W[N][M], const double *f, double *tau) {
  double a = DAMPED * DAMPED, b = 0.0, c = a;
  for (int m = 0; m < M; ++m) a += W[0][m] * W[0][m], b += W[0][m] * W[1][m], c += W[1][m] * W[1][m];
  double y[N] = {(c * f[0] - b * f[1]) / (a * c - b * b), (a * f[1] - b * f[0]) / (a * c - b * b)};
  for (int m = 0; m < M; ++m) tau[m] = W[0][m] * y[0] + W[1][m] * y[1];
}

int main(int count, char **words) {
  static unit_plan plan;
  static double coefficients[ORDER][COLUMNS];
  static const double edges[2] = {0.0, DURATION};
  char why[500] = "";
  if (count != 2) return 2;
  mjModel *model = mj_loadXML(words[1], 0, why, sizeof why);
  if (!model) {
    printf("%s\n", why);
    return 2;
  }
  mjData *data = mj_makeData(model);
  unit_state state;
  unit_motion motion;
  unit_command command;
  unit_efforts efforts;
  unit_jacobians jacobians;
  set_path(coefficients);
  unit_preview preview = {1, ORDER, edges, &coefficients[0][0], DURATION, INFINITY, 0, 0, 1};
  at(coefficients, 0.0, &motion);
  for (int j = 0; j < K; ++j) motion.s[j] = motion.sd[j] = motion.sdd[j] = 0.0;
  if (unit_reset(&state) || unit_go_to(&state, motion.x) || unit_plan_reset(&plan)) return 2;
  for (int q = 0; q < UNIT_NQ; ++q) data->qpos[q] = state.q[q]; /* the machine stands where the path begins */
  mj_forward(model, data);
  double farthest = 0.0, before = 0.0;
  int crossed = 0, worst = 0;
  for (int tick = 0; tick < 1300; ++tick) {
    double t = 1e-3 * tick, joints[NV], rates[NV], e[N], ed[N], f[N], more[M];
    unit_carriers measured;
    if (tick && unit_plan_command_at(&plan, t, &command) == UNIT_PLAN_NONE) return 2;
    for (int j = 0; j < K; ++j) {
      double s = data->qpos[model->jnt_qposadr[model->actuator_trnid[2 * (M + j)]]];
      double sd = data->qvel[model->jnt_dofadr[model->actuator_trnid[2 * (M + j)]]];
      measured.s[j] = tick ? command.s[j] + CORRECTION * (s - command.s[j]) : s;
      measured.sd[j] = tick ? command.sd[j] + CORRECTION * (sd - command.sd[j]) : sd;
    }
    if (tick % 5 == 0) {
      int status = unit_plan_update(&plan, t, &measured, &preview, &command);
      if (status == UNIT_PLAN_NONE || status > UNIT_PLAN_TIME_SCALED) return 2;
      if (status > worst) worst = status;
    }
    at(coefficients, t, &motion);
    for (int j = 0; j < K; ++j) motion.s[j] = command.s[j], motion.sd[j] = command.sd[j], motion.sdd[j] = command.sdd[j];
    if (unit_inverse_dynamics(&state, &motion, &efforts) >= UNIT_UNREACHABLE || unit_jacobians_at(&state, &jacobians)) return 2;
    for (int v = 0; v < NV; ++v) joints[v] = data->qpos[v] - state.q[v], rates[v] = data->qvel[v];
    for (int v = 0; v < NV; ++v)
      for (int i = 0; i < N; ++i) rates[v] -= jacobians.gamma[v][i] * motion.xd[i];
    for (int j = 0; j < K; ++j) { /* carriers have no part in the loops, nor in the platform */
      int v = model->jnt_dofadr[model->actuator_trnid[2 * (M + j)]];
      joints[v] = rates[v] = 0.0;
    }
    platform_error(jacobians.gamma, joints, e), platform_error(jacobians.gamma, rates, ed);
    for (int i = 0; i < N; ++i) f[i] = -STIFFNESS * e[i] - DAMPING * ed[i];
    damped_efforts(efforts.W, f, more);
    for (int m = 0; m < M; ++m) data->ctrl[m] = command.tau[m] + more[m];
    for (int j = 0; j < K; ++j) {
      double s = data->qpos[model->jnt_qposadr[model->actuator_trnid[2 * (M + j)]]];
      double sd = data->qvel[model->jnt_dofadr[model->actuator_trnid[2 * (M + j)]]];
      data->ctrl[M + j] = command.carrier_force[j] + HOLD * (command.s[j] - s) + SLOW * (command.sd[j] - sd);
    }
    double side = efforts.W[0][0] * efforts.W[1][1] - efforts.W[0][1] * efforts.W[1][0];
    crossed += side * before < 0.0;
    before = side != 0.0 ? side : before;
    farthest = fmax(farthest, hypot(e[0], e[1]));
    mj_step(model, data);
  }
  printf("largest distance %.3g m, crossings %d, worst status %d, command at rest %.3g N\n", farthest, crossed, worst, fabs(command.tau[0]));
  mj_deleteData(data);
  mj_deleteModel(model);
  return 0;
}

/* What Python calls: motions, starts, and many samples of one function. It stands behind driver.c. */

const int rp_alignments = NALIGN, rp_turnings = NT;

/* A motion of `samples` samples from the configuration q0, closed at x0; returns how many were done before one failed,
   with its status in status[]. */
int rp_lift(int samples, const double *t, const double *x, const double *xd, const double *xdd, const double *q0,
            const double *x0, double *q, double *trig, double *v, double *a, double *gamma, double *W,
            double *gap, double *margin, int *status) {
  Pose pose, next;
  double guess[NQ], step[NP + 1], before = 0.0;
  int known = 0; /* samples before this one, at most two, from which its configuration can be extrapolated */
  if (!start_at(&pose, q0, x0)) return 0;
  for (int k = 0; k < samples; ++k) {
    const double *xk = x + (long)k * NX;
    double *vk = v + (long)k * NV, *ak = a + (long)k * NV, dt = k ? t[k] - t[k - 1] : 0.0;
    int closed = 0;
    if (known) {
      copy(guess, pose.q, NQ);
      for (int i = 0; i < NP; ++i) {
        int c = COLUMNS[i];
        double bend = 0.5 * ak[c - NV];
        if (known > 1) bend += (ak[c - NV] - ak[c - 2 * NV]) * dt / (6.0 * before);
        step[i] = dt * (vk[c - NV] + dt * bend);
      }
      move(guess, step);
      closed = newton(guess, xk, 0, &next) && next.sign == pose.sign;
    }
    if (closed)
      pose = next;
    else
      closed = follow(&pose, xk);
    status[k] = closed ? CLOSED : LOST;
    gap[k] = closed ? pose.gap : NAN;
    if (closed) {
      margin[k] = rates(&pose, xd + (long)k * N, xdd + (long)k * N, vk, ak, gamma + (long)k * NV * N,
                        W + (long)k * N * M);
      if (margin[k] < LEAST_MARGIN)
        status[k] = SINGULAR;
      else if (!in_mode(&pose))
        status[k] = OTHER_MODE;
      copy(q + (long)k * NQ, pose.q, NQ);
      copy(trig + (long)k * 2 * NT, pose.trig, 2 * NT);
    }
    if (status[k] != CLOSED) return k;
    known = known && dt > 0.0 ? 2 : 1; /* where an instant stands twice the acceleration jumps */
    before = dt;
  }
  return samples;
}

/* From one configuration to other coordinates; q is replaced. */
int rp_follow(double *q, const double *x0, const double *x) {
  Pose pose;
  if (!start_at(&pose, q, x0) || !follow(&pose, x)) return LOST;
  copy(q, pose.q, NQ);
  return in_mode(&pose) ? CLOSED : OTHER_MODE;
}

/* The configuration near q that misses x least (Levenberg and Marquardt); returns the largest residual left, m or rad. */
double rp_assemble(double *q, const double *x) {
  double residual[NP + 1], K[NP * NP + 1], alignment[NALIGN], trial[NQ], trig[2 * NT + 1], damping = 1e-3, size = 0.0;
  turns_of(q, trig);
  rows(q, trig, x, residual, K, alignment);
  for (int i = 0; i < NP; ++i) size += residual[i] * residual[i];
  for (int iteration = 0; iteration < 200 && size > 0.0; ++iteration) {
    double H[NP * NP + 1], step[NP + 1], new_residual[NP + 1], new_K[NP * NP + 1], new_size = 0.0;
    int pivot[NP + 1];
    for (int i = 0; i < NP; ++i) {
      step[i] = 0.0;
      for (int k = 0; k < NP; ++k) step[i] += K[k + i * NP] * residual[k];
      for (int j = 0; j < NP; ++j) {
        double sum = i == j ? damping : 0.0;
        for (int k = 0; k < NP; ++k) sum += K[k + i * NP] * K[k + j * NP];
        H[i + j * NP] = sum;
      }
    }
    if (decompose(H, pivot) == 0.0) break;
    solve(H, pivot, step);
    double longest = largest(step, NP);
    if (longest > 1.0)
      for (int i = 0; i < NP; ++i) step[i] /= longest;
    copy(trial, q, NQ);
    move(trial, step);
    turns_of(trial, trig);
    rows(trial, trig, x, new_residual, new_K, alignment);
    for (int i = 0; i < NP; ++i) new_size += new_residual[i] * new_residual[i];
    if (new_size < size) {
      copy(q, trial, NQ);
      copy(residual, new_residual, NP);
      copy(K, new_K, NP * NP);
      int stalled = new_size > 0.999999 * size && longest < 1e-6;
      size = new_size;
      damping = fmax(damping * 0.2, 1e-15);
      if (stalled || longest < 1e-14) break;
    } else {
      damping *= 8.0;
      if (damping > 1e8 || longest < 1e-14) break; /* refused for rounding: smaller ones are no better */
    }
  }
  turns_of(q, trig);
  rows(q, trig, x, residual, K, alignment);
  double gap = largest(residual, NP);
  for (int i = 0; i < NALIGN; ++i)
    if (!(alignment[i] > 0.0)) gap = fmax(gap, acos(fmax(-1.0, alignment[i])));
  return gap;
}

/* Many samples of one generated function, its arguments and results one after the other in memory. */
typedef void (*Generated)(const double *const *, double *const *);

void rp_map(Generated function, long samples, int inputs, const double **in, const long *in_size, int outputs,
            double **out, const long *out_size) {
  const double *arg[16];
  double *res[16];
  for (long k = 0; k < samples; ++k) {
    for (int i = 0; i < inputs; ++i) arg[i] = in[i] + k * in_size[i];
    for (int i = 0; i < outputs; ++i) res[i] = out[i] + k * out_size[i];
    function(arg, res);
  }
}

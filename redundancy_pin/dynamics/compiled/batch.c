/* What Python calls: motions, starts, and many samples of one function. It stands behind terms.c. */

/* A motion of `samples` samples, on the branch of the closed configuration q0. Returns how many samples there are before the first that
   is not closed, or at a rank loss. */
int rp_lift(const double *numbers, int samples, const double *t, const double *x, const double *xd, const double *xdd, const double *q0,
            double *q, double *trig, double *v, double *a, double *gamma, double *W, double *residuals, double *sizes) {
  double here[NX];
  Branch branch;
  long k = 0;
  branch.known = 0;
  if (pose_at(numbers, q0, 0.0, &branch.pose, here) || !go_far(numbers, &branch.pose, here, x)) return 0;
  for (; k < samples; ++k) {
    if (next_sample(numbers, &branch, k ? t[k] - t[k - 1] : 0.0, x + k * NX, xd + k * N, xdd + k * N, gamma + k * NV * N, W + k * N * M,
                    sizes + 2 * k))
      break;
    copy(q + k * NQ, branch.pose.q, NQ);
    copy(trig + k * 2 * NT, branch.pose.trig, 2 * NT);
    copy(v + k * NV, branch.v, NV);
    copy(a + k * NV, branch.a, NV);
    residuals[k] = branch.pose.residual * LENGTH;
  }
  return (int)before_rank_loss(sizes, k);
}

/* Many samples of one generated function, its arguments and results one after the other in memory. */
typedef void (*Generated)(const double *const *, double *const *);

void rp_map(const double *numbers, Generated function, long samples, int inputs, const double **in, const long *in_size, int outputs,
            double **out, const long *out_size) {
  const double *arg[16];
  double *res[16];
  for (long k = 0; k < samples; ++k) {
    for (int i = 0; i < inputs; ++i) arg[i] = in[i] + k * in_size[i];
    arg[inputs] = numbers;
    for (int i = 0; i < outputs; ++i) res[i] = out[i] + k * out_size[i];
    function(arg, res);
  }
}

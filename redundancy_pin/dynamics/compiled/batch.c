/* What Python calls: motions, starts, and many samples of one function. It stands behind driver.c. */

/* The largest rate of the pose columns, rad or characteristic lengths per unit of time. */
static double largest_rate(const double *numbers, const double *v) {
  double result = 0.0;
  for (int i = 0; i < NP; ++i) result = fmax(result, fabs(v[COLUMNS[i]]) / STEP_UNIT[i]);
  return result;
}

/* Whether a margin, rates and accelerations show a rank loss that a motion steps across. A configuration that is good to 1e-16
   gives accelerations to the square of the rates times 1e-16 / margin^3. A share of 1e-5 and more of them is too much;
   towards a stretched leg they are themselves as large as rates squared over the margin squared, and stay good. Small
   margins all along, as of short levers, are none: usual is the largest of the motion. */
static int blurred(double margin, double usual, double size, double squared) {
  return margin < 0.1 * usual && margin * margin * margin * size < 1e-16 / 1e-5 * squared;
}

/* A motion of `samples` samples from the configuration q0, closed at x0; returns how many were done before one failed. */
int rp_lift(const double *numbers, int samples, const double *t, const double *x, const double *xd, const double *xdd, const double *q0,
            const double *x0, double *q, double *trig, double *v, double *a, double *gamma, double *W,
            double *gap, double *margin) {
  Pose pose, next;
  double guess[NQ], step[NP + 1], before = 0.0;
  int known = 0; /* samples before this one, at most two, from which its configuration can be extrapolated */
  if (!start_at(numbers, &pose, q0, x0)) return 0;
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
      closed = newton(numbers, guess, xk, 0, &next) && next.sign == pose.sign;
    }
    if (closed)
      pose = next;
    else
      closed = follow(numbers, &pose, xk);
    if (!closed) return k;
    gap[k] = pose.gap * LENGTH;
    margin[k] = rates(numbers, &pose, xd + (long)k * N, xdd + (long)k * N, vk, ak, gamma + (long)k * NV * N,
                      W + (long)k * N * M);
    if (margin[k] < LEAST_MARGIN || !in_mode(numbers, &pose)) return k;
    copy(q + (long)k * NQ, pose.q, NQ);
    copy(trig + (long)k * 2 * NT, pose.trig, 2 * NT);
    known = known && dt > 0.0 ? 2 : 1; /* where an instant stands twice the acceleration jumps */
    before = dt;
  }
  double usual = 0.0;
  for (int k = 0; k < samples; ++k)
    if (isfinite(margin[k])) usual = fmax(usual, margin[k]);
  for (int k = 0; k < samples; ++k) {
    if (!(margin[k] < 0.1 * usual)) continue;
    double fastest = largest_rate(numbers, v + (long)k * NV), squared = fastest * fastest;
    if (blurred(margin[k], usual, fmax(largest_rate(numbers, a + (long)k * NV), squared), squared)) return k;
  }
  return samples;
}

static double distance(const double *a, const double *b, int size) {
  double result = 0.0;
  for (int i = 0; i < size; ++i) result = fmax(result, fabs(a[i] - b[i]));
  return result;
}

/* f and forces as terms of the carriers' motion, at a configuration and motion of the tree: constant (N + NK) with the
   carriers at rest at s = 0, and terms (NK, 5, N + NK), what a carrier adds by unit of s, s^2, sd, s sd and sdd. These
   are read off the derivatives by s, sd and sdd at rest, and at s = sd = 1. */
static void terms_of(const double *numbers, const Pose *pose, const double *v, const double *a, const double *gamma, const double *wrenches,
                     double *constant, double *terms) {
  enum { OF_F = N * NK + 1, OF_FORCE = NK * NK + 1 };
  double rest[NK + 1] = {0.0}, one[NK + 1], force[NK + 1], of_f[6][OF_F], of_force[6][OF_FORCE];
  for (int c = 0; c < NK; ++c) one[c] = 1.0;
  const double *const at_rest[] = {pose->q, pose->trig, v, a, gamma, rest, rest, rest, wrenches, numbers};
  const double *const at_one[] = {pose->q, pose->trig, v, a, gamma, one, one, rest, wrenches, numbers};
  double *const value[] = {constant, force};
  double *const first[] = {of_f[0], of_f[1], of_f[2], of_force[0], of_force[1], of_force[2]};
  double *const second[] = {of_f[3], of_f[4], of_f[5], of_force[3], of_force[4], of_force[5]};
  rp_project(at_rest, value);
  copy(constant + N, force, NK);
  rp_derivatives(at_rest, first);
  rp_derivatives(at_one, second);
  clear(terms, NK * 5 * (N + NK));
  for (int c = 0; c < NK; ++c)
    for (int i = 0; i <= N; ++i) {
      int last = i == N, place = last ? c * NK + c : i * NK + c; /* the last row is the carrier's own force */
      double d[6], *to = terms + (long)c * 5 * (N + NK) + (last ? N + c : i);
      for (int j = 0; j < 6; ++j) d[j] = last ? of_force[j][place] : of_f[j][place];
      double both = d[4] - d[1];
      to[0] = d[0];
      to[N + NK] = 0.5 * (d[3] - d[0] - both);
      to[2 * (N + NK)] = d[1];
      to[3 * (N + NK)] = both;
      to[4 * (N + NK)] = d[2];
    }
}

/* The same, and W, at samples of a motion: `width` numbers each, t, x, xd, xdd and wrenches. It goes on from one of two
   configurations near[] with their coordinates (NaN: none), by Newton's method alone and from sample to sample; on the
   other side of a type I singularity, or where Newton's method does not contract, it ends with LOST and says nothing:
   the way there is for rp_lift. out: W, constant and terms, those of all samples side by side. sizes: three numbers a
   sample of memory. Afterwards near[] holds the first and the last sample. */
int rp_terms(const double *numbers, int samples, const double *in, int width, double *near, double *out, double *sizes) {
  enum { SUM = N + NK };
  double *W = out, *constant = W + (long)samples * N * M, *terms = constant + (long)samples * SUM;
  double v[NV], a[NV], gamma[NV * N + 1], ends[2][NQ + NX], step[NP + 1], guess[NQ], usual = 0.0;
  const double *x0 = in + 1, *start = near;
  Pose pose, next;
  for (int r = 1; r < NEIGHBOURS; ++r) {
    const double *other = near + r * (NQ + NX);
    if (isnan(other[0])) continue; /* none yet */
    if (isnan(start[0]) || distance(other + NQ, x0, NX) < distance(start + NQ, x0, NX)) start = other;
  }
  if (isnan(start[0]) || !start_at(numbers, &pose, start, start + NQ)) return LOST;
  for (long k = 0; k < samples; ++k) {
    const double *at = in + k * width, *x = at + 1, *xd = x + NX, *xdd = xd + N;
    double dt = k ? at[0] - at[-width] : 0.0, fastest, squared;
    if (!isfinite(at[0]) || dt < 0.0) return NOT_FINITE;
    copy(guess, pose.q, NQ);
    if (k) {
      for (int i = 0; i < NP; ++i) step[i] = dt * (v[COLUMNS[i]] + 0.5 * dt * a[COLUMNS[i]]);
      move(guess, step);
    }
    if (!newton(numbers, guess, x, 0, &next) || next.sign != pose.sign) {
      if (!k || !newton(numbers, pose.q, x, 0, &next) || next.sign != pose.sign) return LOST;
    }
    pose = next;
    double margin = rates(numbers, &pose, xd, xdd, v, a, gamma, W + k * N * M);
    if (margin < LEAST_MARGIN) return SINGULAR;
    if (!in_mode(numbers, &pose)) return OTHER_MODE;
    terms_of(numbers, &pose, v, a, gamma, xdd + N, constant + k * SUM, terms + k * NK * 5 * SUM);
    fastest = largest_rate(numbers, v);
    squared = fastest * fastest;
    sizes[3 * k] = margin;
    sizes[3 * k + 1] = fmax(largest_rate(numbers, a), squared);
    sizes[3 * k + 2] = squared;
    if (isfinite(margin)) usual = fmax(usual, margin);
    if (!k || k == samples - 1) {
      copy(ends[k > 0], pose.q, NQ);
      copy(ends[k > 0] + NQ, x, NX);
    }
  }
  for (long k = 0; k < samples; ++k)
    if (blurred(sizes[3 * k], usual, sizes[3 * k + 1], sizes[3 * k + 2])) return SINGULAR;
  for (long i = 0; i < (long)samples * (N * M + SUM + NK * 5 * SUM); ++i)
    if (!isfinite(out[i])) return NOT_FINITE;
  for (int r = NEIGHBOURS - 1; r > 1; --r) copy(near + r * (NQ + NX), near + (r - 2) * (NQ + NX), NQ + NX);
  copy(near, ends[0], NQ + NX);
  copy(near + NQ + NX, ends[samples > 1], NQ + NX);
  return CLOSED;
}

/* From one configuration to other coordinates; q is replaced. */
int rp_follow(const double *numbers, double *q, const double *x0, const double *x) {
  Pose pose;
  if (!start_at(numbers, &pose, q, x0) || !go_far(numbers, &pose, x0, x)) return LOST;
  copy(q, pose.q, NQ);
  return in_mode(numbers, &pose) ? CLOSED : OTHER_MODE;
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

/* W, f and forces as terms of the carriers' motion, a few samples at a time, each batch followed from those before. It stands behind
   driver.c. */

/* Whether margins, rates and accelerations (sizes, by sample as next_sample writes them) show a rank loss that a motion steps across. A
   configuration that is good to 1e-16 gives accelerations to the square of the rates times 1e-16 / margin^3. A share of 1e-5
   and more of them is too much; towards a stretched leg they are themselves as large as rates squared over the margin squared,
   and stay good. Small margins all along, as of short levers, are none: a tenth of the largest of the motion is. Returns the number of
   samples before it, all if there is none. */
static long before_rank_loss(const double *sizes, long samples) {
  double usual = 0.0;
  for (long k = 0; k < samples; ++k)
    if (isfinite(sizes[2 * k])) usual = fmax(usual, sizes[2 * k]);
  for (long k = 0; k < samples; ++k) {
    double margin = sizes[2 * k];
    if (margin < 0.1 * usual && margin * margin * margin < ROUNDED_SHARE * sizes[2 * k + 1]) return k;
  }
  return samples;
}

/* The branch of a motion, and the rates (NV) of its last samples: `known` of them, at most two. */
typedef struct {
  Pose pose;
  double v[NV], a[NV], a_before[NV], dt;
  int known;
} Branch;

/* Goes on to a sample that is dt after the last one, by Newton's method from where rates and accelerations lead, otherwise on the
   straight way. gamma (NV x N) and W (N x M) are those of the sample; sizes: its margin, and the share of the largest rate squared
   in the largest acceleration, at most 1. Returns STATUS_OK, or why not. */
static int next_sample(const double *numbers, Branch *branch, double dt, const double *x, const double *xd, const double *xdd, double *gamma,
                 double *W, double *sizes) {
  int closed = 0;
  if (branch->known) {
    double step[NP + 1];
    Pose next = branch->pose;
    for (int i = 0; i < NP; ++i) {
      int c = COLUMNS[i];
      double bend = 0.5 * branch->a[c];
      if (branch->known > 1) bend += (branch->a[c] - branch->a_before[c]) * dt / (6.0 * branch->dt);
      step[i] = dt * (branch->v[c] + dt * bend);
    }
    move(next.q, step);
    closed = !close_at(numbers, &next, x, 0);
    if (closed) branch->pose = next;
  }
  if (!closed && !follow(numbers, &branch->pose, x)) return STATUS_UNREACHABLE;
  if (branch->known) copy(branch->a_before, branch->a, NV);
  sizes[0] = rates(numbers, &branch->pose, xd, xdd, branch->v, branch->a, gamma, W);
  if (sizes[0] < SINGULAR_MARGIN) return STATUS_TYPE_I;
  if (!in_mode(numbers, &branch->pose)) return STATUS_BRANCH_LOST;
  double fastest = largest_over(branch->v, VELOCITY_UNIT, NV);
  sizes[1] = fastest > 0.0 ? fastest * fastest / fmax(largest_over(branch->a, VELOCITY_UNIT, NV), fastest * fastest) : 0.0;
  branch->known = branch->known && dt > 0.0 ? 2 : 1; /* where an instant stands twice the acceleration jumps */
  branch->dt = dt;
  return STATUS_OK;
}

static double distance(const double *a, const double *b, int size) {
  double result = 0.0;
  for (int i = 0; i < size; ++i) result = fmax(result, fabs(a[i] - b[i]));
  return result;
}

/* W, f and forces as terms of the carriers' motion, at samples of a motion: `width` numbers each, t, x, xd, xdd and wrenches. It goes on
   from one of the configurations near[] with their coordinates (NaN: none), to the first sample by Newton's method alone: a way there
   that is long is for rp_lift. out: W (N, M), constant (N + NK) and terms (NK, TERMS, N + NK) of redundancy_pin.CarrierTerms,
   those of all samples side by side. sizes: two numbers a sample of memory. Returns how many samples there are before the first that is
   not closed, not finite, or at a rank loss; but for a rank loss near[] then begins with the first and the last of them. */
SHARED int rp_terms(const double *numbers, int samples, const double *in, int width, double *near, double *out, double *sizes) {
  enum { SUM = N + NK, ALL = NK * TERMS * SUM };
  double *W = out, *constant = W + (long)samples * N * M, *terms = constant + (long)samples * SUM;
  double gamma[NV * N + 1], ends[2][NQ + NX];
  const double *start = near;
  Branch branch;
  long closed = 0;
  branch.known = 0;
  for (int r = 1; r < NEIGHBOURS; ++r) {
    const double *other = near + r * (NQ + NX);
    if (isnan(other[0])) continue; /* none yet */
    if (isnan(start[0]) || distance(other + NQ, in + 1, NX) < distance(start + NQ, in + 1, NX)) start = other;
  }
  if (isnan(start[0]) || !newton(numbers, start, start + NQ, 0, &branch.pose) || close_at(numbers, &branch.pose, in + 1, 0)) return 0;
  for (; closed < samples; ++closed, W += N * M, constant += SUM, terms += ALL) {
    const double *at = in + closed * width, *x = at + 1, *xd = x + NX, *xdd = xd + N;
    double dt = closed ? at[0] - at[-width] : 0.0;
    if (!isfinite(at[0]) || dt < 0.0 || next_sample(numbers, &branch, dt, x, xd, xdd, gamma, W, sizes + 2 * closed)) break;
    const double *const arg[] = {branch.pose.q, branch.pose.trig, branch.v, branch.a, gamma, xdd + N, numbers};
    double *const res[] = {constant, terms};
    rp_carrier_terms(arg, res);
    if (!finite(W, N * M) || !finite(constant, SUM) || !finite(terms, ALL)) break;
    copy(ends[closed > 0], branch.pose.q, NQ);
    copy(ends[closed > 0] + NQ, x, NX);
  }
  long before = before_rank_loss(sizes, closed);
  if (before < closed || !closed) return (int)before;
  for (int r = NEIGHBOURS - 1; r > 1; --r) copy(near + r * (NQ + NX), near + (r - 2) * (NQ + NX), NQ + NX);
  copy(near, ends[0], NQ + NX);
  copy(near + NQ + NX, ends[closed > 1], NQ + NX);
  return (int)closed;
}

/* Integration of the forward dynamics of one robot in time. The structures Run and Progress stand in front of this text, see
   integration.py, and forward.c.

   It takes what is ordinary: steps in which nothing happens. Before a step in which something may (an event, closures that come near
   a rank loss, a step that fails or shrinks) it stops, and leaves that one to its caller. */

#define NY (NQ + NV)
#define MOST_LOOKS 64 /* at the rank of the closures in a step, no unit; longer steps are not ordinary */
#define MOST_WATCHED (2 * NQ + LEGS + 4)
#define WATCHED(run) ((run)->stops + (LEGS ? LEGS : 1) + (M == N) + 1)

/* Values of piecewise polynomials at an instant, those at the ends outside; *piece is where the last one was. */
static void polynomials(const double *edges, int pieces, const double *coefficients, int terms, int width, double t,
                        int *piece, double *values) {
  while (*piece + 1 < pieces && t >= edges[*piece + 1]) ++*piece;
  while (*piece > 0 && t < edges[*piece]) --*piece;
  double left = edges[*piece], x = fmin(fmax(t, left), edges[*piece + 1]) - left;
  const double *c = coefficients + (long)*piece * terms * width;
  clear(values, width);
  for (int k = 0; k < terms; ++k)
    for (int i = 0; i < width; ++i) values[i] = values[i] * x + *c++;
}

/* What acts at an instant: the piece of the polynomials is that of a time before the end of the stretch. */
static int loads_at(const Run *run, Progress *at, double t, double end, const double *q, const double *v, double *out) {
  double before = t < end ? t : nextafter(end, -INFINITY);
  if (run->loads) return run->loads(before, q, v, out);
  double u[M + NK + 1];
  polynomials(run->edges, run->pieces, run->coefficients, run->terms, M + NK, before, &at->piece, u);
  clear(out, NV);
  for (int i = 0; i < M + NK; ++i) {
    out[i < M ? ACTUATED[i] : CARRIERS[i - M]] += fmin(fmax(u[i], -run->limits[i]), run->limits[i]);
  }
  return 1;
}

static void rate(const double *numbers, const Run *run, Progress *at, double t, double end, const double *y, double *result) {
  double state[NY], out[NV + 3 * NK + 1];
  ++at->evaluations;
  copy(state, y, NY);
  if (!finite(state, NY)) {
    fill_nan(result, NY);
    return;
  }
  const double *q = state, *v = state + NQ, *given = run->prescribed ? out + NV + 2 * NK : 0;
  int known = loads_at(run, at, t, end, q, v, out);
  if (known && run->prescribed)
    for (int i = 0; i < NK; ++i) state[CARRIED[i]] = out[NV + i], state[NQ + CARRIERS[i]] = out[NV + NK + i];
  if (!known || rp_accelerations(numbers, q, v, out, 0, given, result + NQ, 0, 0)) {
    fill_nan(result, NY);
    return;
  }
  const double *const arg[] = {q, v};
  double *const res[] = {result};
  rp_rates(arg, res);
}

/* Smallest over largest singular value of rows S (R x NP), which are overwritten; of a single row its length, no unit. */
static double rank_ratio(double *S) {
  double square[R + 1], least = INFINITY, most = 0.0;
  orthogonalise(S, R, NP, NP, square);
  for (int i = 0; i < R; ++i) least = fmin(least, square[i]), most = fmax(most, square[i]);
  return R > 1 ? sqrt(least / most) : R ? sqrt(most) : 1.0;
}

/* Determinant of a matrix (NP x NP), or of its transpose; it is overwritten. */
static double determinant(double *A) {
  int pivot[NP + 1];
  double result = decompose(A, NP, pivot);
  for (int i = 0; result != 0.0 && i < NP; ++i) result /= fabs(A[i + i * NP]);
  return result;
}

/* The functions whose zeros are events, at a configuration: stops, type I, type II, rank of the closures. */
static void functions(const double *numbers, const Run *run, const double *q, double *values) {
  double residual[R + 1], K[NP * NP + 1], work[NP * NP + 1];
  closures(numbers, q, residual, work);
  scale_rows(numbers, work, NP, NP, K);
  for (int i = 0; i < run->stops; ++i) {
    const double *stop = run->stop + 4 * i;
    *values++ = stop[2] * (stop[3] - q[(int)stop[0]]);
  }
  if (LEGS) {
    double trig[2 * NT + 1];
    turns_of(q, trig);
    sides_of(numbers, q, trig, values);
    for (int i = 0; i < LEGS; ++i) *values++ *= run->mode[i];
  } else {
    copy(work, K, NP * NP);
    *values++ = determinant(work);
  }
  if (M == N) {
    copy(work, K, R * NP);
    for (int i = R; i < NP; ++i)
      for (int j = 0; j < NP; ++j) work[i * NP + j] = i - R < M && COLUMNS[j] == ACTUATED[i - R];
    *values++ = determinant(work);
  }
  *values = rank_ratio(K);
}

/* Rates of the stages from `first` to `last` of a step, and the state y1 at its end; returns whether all of them have an answer. */
static int stages(const double *numbers, const Run *run, Progress *at, double h, double end, const double *y, double *y1, double *K, int first,
                  int last) {
  for (int s = first; s <= last; ++s) {
    double state[NY], *rates = K + s * NY;
    copy(state, y, NY);
    for (int k = 0; k < s; ++k) {
      double share = h * run->A[s * run->rows + k];
      if (share != 0.0)
        for (int i = 0; i < NY; ++i) state[i] += share * K[k * NY + i];
    }
    rate(numbers, run, at, at->t + run->C[s] * h, end, state, rates);
    if (s == run->stages) copy(y1, state, NY);
    if (rates[NQ] != rates[NQ]) return 0;
  }
  return 1;
}

/* The state at a share x of a step, by the interpolant of the method. */
static void between(const Run *run, double h, const double *y, const double *K, double x, double *out) {
  copy(out, y, NY);
  for (int s = 0; s < run->rows; ++s) {
    double weight = 0.0;
    for (int p = run->powers - 1; p >= 0; --p) weight = x * (weight + run->P[s * run->powers + p]);
    for (int i = 0; i < NY; ++i) out[i] += h * weight * K[s * NY + i];
  }
}

/* A step of at most *h, shortened until its error is within the tolerances, and the length for the next in *h; returns the
   time at its end, or NaN where no step is short enough. Step control is scipy's. */
static double take(const double *numbers, const Run *run, Progress *at, double end, const double *y, double *h, double *y1, double *K) {
  double least = 10.0 * (nextafter(at->t, INFINITY) - at->t), length = fmax(fmin(*h, run->max_step), least);
  int rejected = 0;
  for (;;) {
    double e5 = 0.0, e3 = 0.0, error = NAN;
    if (!(length >= least)) return NAN;
    double t1 = fmin(at->t + length, end);
    length = t1 - at->t;
    if (stages(numbers, run, at, length, end, y, y1, K, 1, run->stages)) {
      for (int i = 0; i < NY; ++i) {
        double scale = run->atol[i] + fmax(fabs(y[i]), fabs(y1[i])) * run->rtol, five = 0.0, three = 0.0;
        for (int s = 0; s <= run->stages; ++s) {
          five += K[s * NY + i] * run->E[s];
          three += K[s * NY + i] * run->E3[s];
        }
        e5 += five / scale * (five / scale);
        e3 += three / scale * (three / scale);
      }
      error = e5 == 0.0 && e3 == 0.0 ? 0.0 : length * e5 / sqrt((e5 + 0.01 * e3) * NY);
    }
    double factor = error == error ? 0.9 * pow(error, -1.0 / (run->order + 1.0)) : 0.2;
    if (error < 1.0) {
      *h = length * fmin(rejected ? 1.0 : 10.0, factor);
      return t1;
    }
    length *= fmax(0.2, factor);
    rejected = 1;
  }
}

/* Whether a function like |t - t0| may come to zero between looks at it, or below `near`. */
static int may_touch_zero(const double *ratios, int count, double near) {
  int lowest = 0;
  double change = 0.0, least = INFINITY;
  for (int i = 0; i < count; ++i)
    if (!(ratios[i] >= ratios[lowest])) lowest = i;
  if (lowest && !(ratios[lowest] >= near)) return 1;
  for (int i = 1; i < count; ++i) {
    change = fmax(change, fabs(ratios[i] - ratios[i - 1]));
    least = fmin(least, ratios[i] + ratios[i - 1]);
  }
  return !(least > 1.5 * change);
}

/* Whether nothing happens in a step: no sign of a function changes, no joint turns back near its stop, the closures keep
   away from a rank loss. `values` (WATCHED) are the functions at its start and, if so, afterwards at its end; so is near, the ratio below
   which a rank loss is looked for. */
static int ordinary(const double *numbers, const Run *run, Progress *at, double h, double end, const double *y, const double *y1, double *K,
                    double *values, double *near, int *dense) {
  double speed = fmax(1.0 / run->time, fmax(largest_over(y + NQ, VELOCITY_UNIT, NV), largest_over(y1 + NQ, VELOCITY_UNIT, NV)));
  int fine = !(h * speed < run->brief) || values[WATCHED(run) - 1] < run->near_rank, looks = fine ? 4 : 1;
  double states[5][NY], seen[5][MOST_WATCHED], ratios[MOST_LOOKS], travel = 0.0;
  const double *f0 = K, *f1 = K + run->stages * NY;
  int watched = WATCHED(run);
  copy(states[0], y, NY);
  copy(seen[0], values, watched);
  for (int k = 1; k <= looks; ++k) {
    double x = (double)k / looks, late = x * x * (3.0 - 2.0 * x), up = x * (1.0 - x) * (1.0 - x), down = -x * x * (1.0 - x);
    for (int i = 0; i < NY; ++i)
      states[k][i] = (1.0 - late) * y[i] + late * y1[i] + h * (up * f0[i] + down * f1[i]);
    functions(numbers, run, states[k], seen[k]);
    for (int i = 0; i < watched - 1; ++i)
      if (!(seen[k - 1][i] * seen[k][i] > 0.0)) return 0;
    for (int i = 0; i < run->stops; ++i) {
      const double *stop = run->stop + 4 * i;
      double r0 = -stop[2] * states[k - 1][NQ + (int)stop[1]], r1 = -stop[2] * states[k][NQ + (int)stop[1]];
      if (r0 < 0.0 && r1 > 0.0 && fmin(seen[k - 1][i], seen[k][i]) < h / looks * fmax(-r0, r1)) return 0;
    }
  }
  for (int k = 0; k <= looks; ++k) {
    double most = 0.0;
    for (int j = 0; j < NP; ++j) most = fmax(most, fabs(states[k][NQ + COLUMNS[j]]) / VELOCITY_UNIT[COLUMNS[j]]);
    travel += most / (looks + 1);
    ratios[k] = seen[k][watched - 1];
  }
  travel *= h;
  if (!(travel / run->check_travel < MOST_LOOKS - 1)) return 0;
  int count = (int)(travel / run->check_travel);
  if (count > looks) {
    double state[NY], all[MOST_WATCHED];
    *dense = stages(numbers, run, at, h, end, y, 0, K, run->stages + 1, run->rows - 1);
    for (int k = 0; k <= count; ++k) {
      between(run, h, y, K, (double)k / count, state);
      functions(numbers, run, state, all);
      ratios[k] = all[watched - 1];
    }
  } else
    count = looks;
  if (may_touch_zero(ratios, count + 1, *near)) return 0;
  if (!(ratios[count] < run->near_rank)) *near = run->near_rank;
  copy(values, seen[looks], watched);
  return 1;
}

/* Onto the closures, carriers where their motion is given. */
static int placed(const double *numbers, const Run *run, Progress *at, double t, double end, double *y, double *residuals) {
  double out[NV + 3 * NK + 1];
  if (run->prescribed) {
    if (!loads_at(run, at, t, end, y, y + NQ, out)) return 0;
    for (int i = 0; i < NK; ++i) y[CARRIED[i]] = out[NV + i], y[NQ + CARRIERS[i]] = out[NV + NK + i];
  }
  return rp_projected(numbers, y, run->tolerance, residuals);
}

/* From a closed state y over at most `most` ordinary steps. Returns 1 before a step that its caller must take, 0 at the end or
   after that many steps. y, the functions `values` and the progress are those of the last state. */
int rp_advance(const double *numbers, const Run *run, Progress *at, double *y, double *values, long most) {
  double *const K = run->rates, y1[NY], next[NY], sample[NY], residuals[2], other[2];
  long limit = at->steps + most;
  int known = 0;
  while (at->next_break < run->breaks) {
    double end = run->break_at[at->next_break];
    if (at->t >= end) {
      ++at->next_break;
      known = 0;
      continue;
    }
    if (at->steps >= limit) return 0;
    if (!known) {
      rate(numbers, run, at, at->t, end, y, K);
      ++at->restarts;
      if (K[NQ] != K[NQ]) return 1;
      at->next_step = fmin(at->next_step, end - at->t);
    }
    known = 1;
    double h = at->next_step, t1 = take(numbers, run, at, end, y, &h, y1, K), length = t1 - at->t;
    if (!(length > 0.0)) return 1;
    double shown[MOST_WATCHED], near = at->near;
    int dense = 0;
    if (length < run->shortest && t1 < end) return 1;
    copy(shown, values, WATCHED(run));
    if (!ordinary(numbers, run, at, length, end, y, y1, K, shown, &near, &dense)) return 1;
    copy(next, y1, NY);
    double change[NV], fastest = fmax(largest_over(y + NQ, VELOCITY_UNIT, NV), largest_over(y1 + NQ, VELOCITY_UNIT, NV));
    int good = placed(numbers, run, at, t1, t1 < end ? end : INFINITY, next, residuals) && residuals[1] <= run->largest_residual;
    for (int i = 0; i < NV; ++i) change[i] = next[NQ + i] - y1[NQ + i];
    if (!good || !(largest_over(change, VELOCITY_UNIT, NV) <= run->velocity_change * fastest + run->velocity_floor / run->time)) return 1;
    while (at->sample < run->samples && run->sample_at[at->sample] < t1 - run->time_tolerance) {
      double t = run->sample_at[at->sample];
      copy(sample, y, NY);
      if (t > at->t) {
        dense = dense || stages(numbers, run, at, length, end, y, 0, K, run->stages + 1, run->rows - 1);
        between(run, length, y, K, (t - at->t) / length, sample);
      }
      if (!placed(numbers, run, at, t, INFINITY, sample, other)) return 1;
      copy(run->recorded + (long)at->sample++ * NY, sample, NY);
    }
    copy(y, next, NY);
    copy(values, shown, WATCHED(run));
    at->t = t1;
    at->near = near;
    at->next_step = h;
    ++at->steps;
    at->largest_correction = fmax(at->largest_correction, residuals[0]);
    if (t1 < end) {
      rate(numbers, run, at, t1, end, y, K);
      if (K[NQ] != K[NQ]) return 1;
    }
  }
  return 0;
}

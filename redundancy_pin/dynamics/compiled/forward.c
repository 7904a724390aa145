/* Forward dynamics of one robot: accelerations, and the projection on the closures. The functions rp_equations, rp_closures and
   rp_platform, and the sizes and tables in capitals are generated in front of this text, see forward.py; so is tree.c.

   Accelerations follow from the equations of motion in independent velocities,

       (N' M N) z = N' (u - rnea(q, v, a0)),   J N = 0,   a = N z + a0,

   which velocities are independent being decided anew at each state, by complete pivoting. Rows and velocities have no units:
   lengths are over the characteristic length (EQUATION_UNIT, VELOCITY_UNIT). */

#define FREE (NP - R + NK)

/* Closure residuals (R), and the rows of closures and platform (NP x NP, column by column). */
static void closures(const double *numbers, const double *q, double *residual, double *K) {
  double trig[2 * NT + 1];
  turns_of(q, trig);
  const double *const arg[] = {q, trig, numbers};
  double *const res[] = {residual, K};
  rp_closures(arg, res);
}

/* The first rows of K (NP x NP, column by column) without units, row by row, `width` numbers apart. Ranks and determinants are
   judged by these: an angle beside a length says something about units only. */
static void scale_rows(const double *numbers, const double *K, int rows, int width, double *scaled) {
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < NP; ++j) scaled[i * width + j] = K[i + j * NP] * (VELOCITY_UNIT[COLUMNS[j]] / EQUATION_UNIT[i]);
}

/* Gauss and Jordan's elimination of rows (R x width), pivots among the first NP columns; the columns of the pivots come in
   order[]. Returns the smallest pivot over the largest. */
static double eliminate(double *A, int width, int *order) {
  double first = 1.0, last = 1.0;
  for (int k = 0; k < R; ++k) {
    int row = k, column = -1;
    double best = -1.0;
    for (int i = k; i < R; ++i)
      for (int j = 0; j < NP; ++j)
        if (fabs(A[i * width + j]) > best) {
          int taken = 0;
          for (int l = 0; l < k; ++l) taken |= order[l] == j;
          if (!taken) best = fabs(A[i * width + j]), row = i, column = j;
        }
    if (!(best > 0.0)) return best == 0.0 ? 0.0 : NAN;
    order[k] = column;
    last = best;
    if (!k) first = best;
    double inverse = 1.0 / A[row * width + column];
    for (int j = 0; j < width; ++j) {
      double swap = A[row * width + j];
      A[row * width + j] = A[k * width + j];
      A[k * width + j] = swap * inverse;
    }
    for (int i = 0; i < R; ++i) {
      double factor = A[i * width + column];
      if (i != k && factor != 0.0)
        for (int j = 0; j < width; ++j) A[i * width + j] -= factor * A[k * width + j];
    }
  }
  return last / first;
}

/* Cholesky's decomposition of a symmetric matrix in place; returns 0 where it is not positive. */
static int factorise(double *A, int size) {
  for (int i = 0; i < size; ++i)
    for (int j = 0; j <= i; ++j) {
      double sum = A[i * size + j];
      for (int k = 0; k < j; ++k) sum -= A[i * size + k] * A[j * size + k];
      if (i == j) {
        if (!(sum > 0.0)) return 0;
        A[i * size + i] = sqrt(sum);
      } else
        A[i * size + j] = sum / A[j * size + j];
    }
  return 1;
}

static void solve_factorised(const double *A, int size, double *b) {
  for (int i = 0; i < size; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= A[i * size + k] * b[k];
    b[i] /= A[i * size + i];
  }
  for (int i = size - 1; i >= 0; --i) {
    for (int k = i + 1; k < size; ++k) b[i] -= A[k * size + i] * b[k];
    b[i] /= A[i * size + i];
  }
}

/* Rows of closures and platform (NP x NP, column by column), their bias, mass matrix and efforts at rest of the tree, under
   wrenches (NWRENCH), or null: a simulation adds their forces itself. */
static void equations(const double *numbers, const double *q, const double *v, const double *wrenches, double *K, double *bias, double *mass,
                      double *effort) {
  static const double NONE[NWRENCH + 1] = {0.0};
  double trig[2 * NT + 1];
  turns_of(q, trig);
  const double *const arg[] = {q, trig, v, wrenches ? wrenches : NONE, numbers};
  double *const res[] = {K, bias, mass, effort};
  rp_equations(arg, res);
}

/* The same at a state, q and v; out: K, bias, mass matrix and efforts, side by side. */
void rp_dynamics(const double *numbers, const double *state, double *out) {
  double *bias = out + NP * NP, *mass = bias + NP;
  equations(numbers, state, state + NQ, 0, out, bias, mass, mass + NV * NV);
}

/* Coordinates of the platform (NX) and their rates (N) at a state, q and v, side by side. */
void rp_platform_at(const double *numbers, const double *state, double *out) {
  double trig[2 * NT + 1];
  turns_of(state, trig);
  const double *const arg[] = {state, trig, state + NQ, numbers};
  double *const res[] = {out, out + NX};
  rp_platform(arg, res);
}

/* Accelerations of the tree under generalised forces (NV) and wrenches (NWRENCH, or null); `given` are those of carriers driven
   by motion, or null. Closure forces (R) and the unbalanced generalised forces `missing` (NV) are computed unless null. Returns
   a status of redundancy_pin.status. */
int rp_accelerations(const double *numbers, const double *q, const double *v, const double *force, const double *wrenches,
                     const double *given, double *a, double *closure_force, double *missing) {
  double K[NP * NP + 1], bias[NP + 1], mass[NV * NV], effort[NV], rest[NV];
  double A[(R + 1) * (NP + 1 + R)], basis[NV][FREE + 1] = {{0.0}}, product[NV][FREE + 1], reduced[FREE * FREE + 1], z[FREE + 1];
  int order[R + 1], dependent[NP + 1] = {0}, width = NP + 1 + (closure_force ? R : 0), d = 0;
  equations(numbers, q, v, wrenches, K, bias, mass, effort);
  scale_rows(numbers, K, R, width, A);
  for (int i = 0; i < R; ++i) {
    A[i * width + NP] = bias[i] / EQUATION_UNIT[i];
    for (int j = NP + 1; j < width; ++j) A[i * width + j] = i == j - NP - 1 ? 1.0 / EQUATION_UNIT[i] : 0.0;
  }
  double ratio = eliminate(A, width, order);
  if (ratio != ratio) return STATUS_NOT_FINITE;
  if (!(ratio > RANK_TOLERANCE)) return STATUS_SINGULAR_INCONSISTENT;
  clear(a, NV);
  for (int k = 0; k < R; ++k) {
    dependent[order[k]] = 1;
    a[COLUMNS[order[k]]] = -A[k * width + NP] * VELOCITY_UNIT[COLUMNS[order[k]]];
  }
  for (int j = 0; j < NP; ++j)
    if (!dependent[j]) {
      basis[COLUMNS[j]][d] = VELOCITY_UNIT[COLUMNS[j]];
      for (int k = 0; k < R; ++k) basis[COLUMNS[order[k]]][d] = -A[k * width + j] * VELOCITY_UNIT[COLUMNS[order[k]]];
      ++d;
    }
  for (int j = 0; j < NK; ++j) {
    if (given)
      a[CARRIERS[j]] = given[j];
    else
      basis[CARRIERS[j]][d++] = VELOCITY_UNIT[CARRIERS[j]];
  }
  for (int i = 0; i < NV; ++i) {
    double sum = force[i] - effort[i];
    clear(product[i], d);
    for (int k = 0; k < NV; ++k) {
      double m = mass[i * NV + k];
      if (m == 0.0) continue;
      sum -= m * a[k];
      for (int j = 0; j < d; ++j) product[i][j] += m * basis[k][j];
    }
    rest[i] = sum;
  }
  clear(z, d);
  clear(reduced, d * d);
  for (int k = 0; k < NV; ++k)
    for (int i = 0; i < d; ++i) {
      double share = basis[k][i];
      if (share == 0.0) continue;
      z[i] += share * rest[k];
      for (int j = 0; j <= i; ++j) reduced[i * d + j] += share * product[k][j];
    }
  for (int i = 0; i < d; ++i)
    for (int j = 0; j <= i; ++j)
      if (!isfinite(reduced[i * d + j])) return STATUS_NOT_FINITE;
  int positive = factorise(reduced, d);
  double least = INFINITY, most = 0.0;
  for (int i = 0; positive && i < d; ++i) {
    double pivot = reduced[i * d + i] * reduced[i * d + i];
    least = fmin(least, pivot);
    most = fmax(most, pivot);
  }
  if (!positive || (d && !(least / most > LEAST_INERTIA))) return STATUS_SINGULAR_INCONSISTENT;
  solve_factorised(reduced, d, z);
  for (int i = 0; i < NV; ++i)
    for (int j = 0; j < d; ++j) a[i] += basis[i][j] * z[j];
  if (!closure_force) return STATUS_OK;
  for (int i = 0; i < NV; ++i) {
    missing[i] = effort[i] - force[i];
    for (int k = 0; k < NV; ++k) missing[i] += mass[i * NV + k] * a[k];
  }
  for (int i = 0; i < R; ++i) {
    closure_force[i] = 0.0;
    for (int k = 0; k < R; ++k) {
      int column = COLUMNS[order[k]];
      closure_force[i] += A[k * width + NP + 1 + i] * missing[column] * VELOCITY_UNIT[column];
    }
  }
  return STATUS_OK;
}

static void fill_nan(double *values, int size) {
  for (int i = 0; i < size; ++i) values[i] = NAN;
}

/* One state from Python: in = q, v, main efforts, carrier forces, wrenches, side by side; out = accelerations (NV), NaN where
   the answer is not STATUS_OK. */
int rp_acceleration(const double *numbers, const double *in, double *out) {
  const double *v = in + NQ, *tau = v + NV, *carrier = tau + M, *wrenches = carrier + NK;
  double force[NV] = {0.0};
  if (!finite(in, NQ + NV + M + NK + NWRENCH)) {
    fill_nan(out, NV);
    return STATUS_NOT_FINITE;
  }
  for (int i = 0; i < M; ++i) force[ACTUATED[i]] = tau[i];
  for (int i = 0; i < NK; ++i) force[CARRIERS[i]] = carrier[i];
  int status = rp_accelerations(numbers, in, v, force, wrenches, 0, out, 0, 0);
  if (status == STATUS_OK && !finite(out, NV)) status = STATUS_NOT_FINITE;
  if (status != STATUS_OK) fill_nan(out, NV);
  return status;
}

/* Onto the closures, at the level of positions and of rates, by the shortest steps without units; residuals: of the closures, before and after, m. */
int rp_projected(const double *numbers, double *y, double wanted, double *residuals) {
  double residual[R + 1], K[NP * NP + 1], S[R * NP + 1], G[R * R + 1], step[NP + 1] = {0.0}, *v = y + NQ;
  for (int iteration = 0; iteration < 9; ++iteration) {
    if (!iteration && NQ != NV) move(y, step); /* which normalises */
    closures(numbers, y, residual, K);
    for (int i = 0; i < R; ++i) residual[i] /= EQUATION_UNIT[i];
    residuals[1] = largest(residual, R) * LENGTH;
    if (!isfinite(residuals[1])) return 0;
    if (!iteration) residuals[0] = residuals[1];
    int last = residuals[1] <= wanted || iteration == 8;
    scale_rows(numbers, K, R, NP, S);
    for (int i = 0; i < R; ++i)
      for (int k = 0; k <= i; ++k)
        G[i * R + k] = dot(S + i * NP, S + k * NP, NP);
    if (!factorise(G, R)) return 0;
    if (last)
      for (int i = 0; i < R; ++i) {
        residual[i] = 0.0;
        for (int j = 0; j < NP; ++j) residual[i] += S[i * NP + j] * v[COLUMNS[j]] / VELOCITY_UNIT[COLUMNS[j]];
      }
    solve_factorised(G, R, residual);
    for (int j = 0; j < NP; ++j) {
      double sum = 0.0;
      for (int i = 0; i < R; ++i) sum += S[i * NP + j] * residual[i];
      step[j] = -sum * VELOCITY_UNIT[COLUMNS[j]];
    }
    if (last) {
      for (int j = 0; j < NP; ++j) v[COLUMNS[j]] += step[j];
      return 1;
    }
    move(y, step);
  }
  return 0;
}

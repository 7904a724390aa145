/* Matrices of the size of one robot (NP x NP), and its generated functions rp_turns, rp_moved and rp_modes. The sizes, tables and names in
   capitals are generated in front of this text, see build.py; driver.c or forward.c stands behind it. No memory is
   allocated; of the standard library math.h alone is used. */

#ifndef APART
#define APART static /* in code for a GPU these are calls, and are not written out at each (many.c, gpu.py) */
#endif

static void copy(double *to, const double *from, int size) {
  for (int i = 0; i < size; ++i) to[i] = from[i];
}

static void clear(double *values, int size) {
  for (int i = 0; i < size; ++i) values[i] = 0.0;
}

/* LU decomposition in place of a square matrix (its columns NP numbers apart) with partial pivoting, one over the pivots on its diagonal;
   returns the sign of the determinant. */
static inline double decompose(double *A, int size, int *pivot) {
  double sign = 1.0;
  for (int j = 0; j < size; ++j) {
    int best = j;
    for (int i = j + 1; i < size; ++i)
      if (fabs(A[i + j * NP]) > fabs(A[best + j * NP])) best = i;
    pivot[j] = best;
    double d = A[best + j * NP];
    if (!(d != 0.0)) return 0.0;
    if (best != j) {
      sign = -sign;
      for (int k = 0; k < size; ++k) {
        double swap = A[j + k * NP];
        A[j + k * NP] = A[best + k * NP];
        A[best + k * NP] = swap;
      }
    }
    if (d < 0.0) sign = -sign;
    double inverse = A[j + j * NP] = 1.0 / d;
    for (int i = j + 1; i < size; ++i) A[i + j * NP] *= inverse;
    for (int k = j + 1; k < size; ++k) {
      double factor = A[j + k * NP];
      if (factor != 0.0) /* many entries of a mechanism's K are zero */
        for (int i = j + 1; i < size; ++i) A[i + k * NP] -= factor * A[i + j * NP];
    }
  }
  return sign;
}

static inline void solve(const double *A, int size, const int *pivot, double *b) {
  for (int j = 0; j < size; ++j) {
    double swap = b[pivot[j]];
    b[pivot[j]] = b[j];
    b[j] = swap;
  }
  for (int j = 0; j < size; ++j)
    if (b[j] != 0.0)
      for (int i = j + 1; i < size; ++i) b[i] -= b[j] * A[i + j * NP];
  for (int j = size - 1; j >= 0; --j) {
    b[j] *= A[j + j * NP];
    if (b[j] != 0.0)
      for (int i = 0; i < j; ++i) b[i] -= b[j] * A[i + j * NP];
  }
}

static int finite(const double *values, int size) {
  for (int i = 0; i < size; ++i)
    if (!isfinite(values[i])) return 0;
  return 1;
}

/* The largest magnitude; NaN where there is one. */
static double largest(const double *values, int size) {
  double result = 0.0;
  for (int i = 0; i < size; ++i)
    if (!(fabs(values[i]) <= result)) {
      result = fabs(values[i]);
      if (isnan(result)) return result; /* no number would be larger than it */
    }
  return result;
}

/* The largest of values without units, each over its own. */
static double largest_over(const double *values, const double *unit, int size) {
  double result = 0.0;
  for (int i = 0; i < size; ++i) result = fmax(result, fabs(values[i]) / unit[i]);
  return result;
}

static void turns_of(const double *q, double *trig) {
  const double *const arg[] = {q};
  double *const res[] = {trig};
  rp_turns(arg, res);
}

/* By leg a number that is positive in the working mode that the numbers say, and zero where modes meet. */
static void sides_of(const double *numbers, const double *q, const double *trig, double *sides) {
  const double *const arg[] = {q, trig, numbers};
  double *const res[] = {sides};
  if (LEGS) rp_modes(arg, res);
}

static void move(double *q, const double *pose_step) {
  double step[NV] = {0.0}, moved[NQ];
  const double *const arg[] = {q, step};
  double *const res[] = {moved};
  for (int i = 0; i < NP; ++i) step[COLUMNS[i]] = pose_step[i];
  rp_moved(arg, res);
  copy(q, moved, NQ);
}

#define SWEEPS 30     /* over all pairs of rows; the convergence is quadratic, 6 x 6 takes some eight */
#define OBLIQUE (4.0 * EPSILON) /* cosine of the angle between two rows below which they count as orthogonal: a few roundings */

static double dot(const double *a, const double *b, int size) {
  double sum = 0.0;
  for (int i = 0; i < size; ++i) sum += a[i] * b[i];
  return sum;
}

static void rotate(double *x, double *y, int size, double cosine, double sine) {
  for (int i = 0; i < size; ++i) {
    double turned = cosine * x[i] - sine * y[i];
    y[i] = sine * x[i] + cosine * y[i];
    x[i] = turned;
  }
}

/* Rotates rows S (rows x width) until their first `columns` entries are orthogonal, whose lengths are then singular values;
   square[] are their squares (one-sided Jacobi; Demmel and Veselic, "Jacobi's method is more accurate than QR", 1992). */
static void orthogonalise(double *S, int rows, int columns, int width, double *square) {
  for (int p = 0; p < rows; ++p) square[p] = dot(S + p * width, S + p * width, columns);
  for (int sweep = 0, moved = 1; moved && sweep < SWEEPS; ++sweep) {
    moved = 0;
    for (int p = 0; p < rows; ++p)
      for (int q = p + 1; q < rows; ++q) {
        double *x = S + p * width, *y = S + q * width, xx = square[p], yy = square[q], xy = dot(x, y, columns), half = 0.5 * (yy - xx);
        if (!(xy * xy > OBLIQUE * OBLIQUE * xx * yy)) continue;
        double root = sqrt(half * half + xy * xy), tangent = xy / (half < 0.0 ? half - root : half + root);
        double cosine = 1.0 / sqrt(1.0 + tangent * tangent);
        rotate(x, y, width, cosine, cosine * tangent);
        square[p] = dot(x, x, columns);
        square[q] = dot(y, y, columns);
        moved = 1;
      }
  }
}

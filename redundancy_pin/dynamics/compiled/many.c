/* Many samples, each by itself: on a GPU a thread for each, by the text of calls.c or, for accelerations, of forward.c, which stands in
   front of this one as it is: NVRTC takes functions and tables with no word before them to be the device's. A compiler of C makes a loop
   over all samples of the same text, which is how it is tested without a GPU. */

#ifdef __CUDACC__
#define KERNEL extern "C" __global__
#define FIRST ((long long)blockIdx.x * blockDim.x + threadIdx.x)
#define EVERY ((long long)gridDim.x * blockDim.x)
#else
#define KERNEL
#define FIRST 0
#define EVERY 1
#endif

/* One quantity of all samples, in the order of the enum that gpu.py writes: entry i of sample k is values[k * sample + i * entry]; null where it is not given, or not asked for. */
typedef struct {
  double *values;
  long long sample, entry;
} Column;

/* Read a quantity, or zeros for null; returns where the next one goes. */
static double *fetch(const Column *column, long long k, double *to, int size) {
  for (int i = 0; i < size; ++i) to[i] = column->values ? column->values[k * column->sample + i * column->entry] : 0.0;
  return to + size;
}

/* Write a quantity, or NaN for null. */
static void store(const Column *column, long long k, const double *from, int size) {
  if (!column->values) return;
  for (int i = 0; i < size; ++i) column->values[k * column->sample + i * column->entry] = from ? from[i] : (double)NAN;
}

/* Machines of one topology, each with its own numbers (NUMBERS), wrenches (NWRENCH), reference (NQ + 1, a state as in calls.c) and
   ranges (count of them); `which` says which machine a sample is of, null: the first. */

#ifdef FORWARD

KERNEL void rp_many_accelerations(long long samples, const Column *columns, const int *which, int *statuses, const double *machines,
                                  const double *wrenches) {
  for (long long k = FIRST; k < samples; k += EVERY) {
    const int machine = which ? which[k] : 0;
    double in[NQ + NV + M + NK + NWRENCH], a[NV], *at = fetch(columns + Q, k, in, NQ);
    at = fetch(columns + V, k, at, NV);
    at = fetch(columns + TAU, k, at, M);
    at = fetch(columns + CARRIER_FORCE, k, at, NK);
    copy(at, wrenches + machine * NWRENCH, NWRENCH);
    statuses[k] = rp_acceleration(machines + machine * NUMBERS, in, a);
    store(columns + A, k, a, NV);
  }
}

#else

/* Closes the loops of every machine at its reference; STATUS_BRANCH_LOST where they do not. */
KERNEL void rp_many_references(long long samples, const double *machines, double *references, int *statuses) {
  for (long long k = FIRST; k < samples; k += EVERY)
    statuses[k] = begin_at(machines + k * NUMBERS, references + k * (NQ + 1)) ? STATUS_OK : STATUS_BRANCH_LOST;
}

/* Efforts of all samples, from START or else from the reference of the machine. Where a sample has no W all is NaN but STATE, which is
   where it started. */
KERNEL void rp_many_efforts(long long samples, const Column *columns, const int *which, int *statuses, const double *machines,
                            const double *wrenches, const double *references, const Range *ranges, int count) {
  for (long long k = FIRST; k < samples; k += EVERY) {
    const int machine = which ? which[k] : 0;
    double state[NQ + 1], in[NX + 2 * N + 3 * NK + NWRENCH], out[N * M + N + NK + 2 + M + 1];
    double *const f = out + N * M, *const force = f + N, *const residual = force + NK, *const tau = residual + 2;
    double *at = fetch(columns + X, k, in, NX);
    at = fetch(columns + XD, k, at, N);
    at = fetch(columns + XDD, k, at, N);
    at = fetch(columns + S, k, at, NK);
    at = fetch(columns + SD, k, at, NK);
    at = fetch(columns + SDD, k, at, NK);
    copy(at, wrenches + machine * NWRENCH, NWRENCH);
    if (columns[START].values)
      fetch(columns + START, k, state, NQ + 1);
    else
      copy(state, references + machine * (NQ + 1), NQ + 1);
    int status = finite(state, NQ) ? torque(machines + machine * NUMBERS, state, in, out, ranges + machine * count, count) : STATUS_NOT_FINITE;
    if (status >= FOR_KINEMATICS) status -= FOR_KINEMATICS;
    const int has_equation = status <= STATUS_UNDERACTUATED || status == STATUS_OUT_OF_RANGE;
    store(columns + TAU, k, has_equation ? tau : 0, M);
    store(columns + CARRIER_FORCE, k, has_equation ? force : 0, NK);
    store(columns + RESIDUAL, k, has_equation ? residual : 0, 1);
    store(columns + SERIAL_MARGIN, k, has_equation ? residual + 1 : 0, 1);
    store(columns + MARGIN, k, has_equation ? tau + M : 0, 1);
    store(columns + STATE, k, state, NQ + 1);
    store(columns + W, k, has_equation ? out : 0, N * M);
    store(columns + F, k, has_equation ? f : 0, N);
    statuses[k] = status;
  }
}

#endif

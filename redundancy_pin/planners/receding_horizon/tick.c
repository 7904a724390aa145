/* One tick as ``planner.py``, ``ahead.py`` and ``programme.py`` have it, where every programme of it has a solution that
   keeps all limits. What has none, and the first tick, is left to them.

   In front of this stand N, M, K, TERMS and COUNT: coordinates, main actuators, carriers, terms of f, nodes; and the
   constants of those files. Names are theirs.

   The programme is condensed: with the motion before it given, W tau = f leaves of (sdd, tau) at a node the M + K - N
   directions of its null space, and s and sd follow. W alone may be singular: that [dW tau, df] is not is what carriers
   are for. What is left is a linear-quadratic problem with bounds, which an interior point method solves, a Riccati
   recursion in each of its steps; the largest effort and the rows of singular instants stand beside it as a border. */

#include <math.h>
#include <string.h>

enum { NX = 3 * K, NF = K + M, NW = NX + M, NZ = NF - N, NV = NX + NZ, LANES = COUNT * K, EFFORTS = COUNT * M };
enum { BORDER = 10, SIDES = BORDER + 1, EARLY = FIRST + 1, INSTANTS = 160, MOST_SINGULAR = (BORDER - 2) / 2 };
enum { TIMES = INSTANTS + COUNT };                  /* of efforts: at instants, and then at nodes */
enum { DONE = 0, UNSOLVED = 1, ELASTIC = 2, REFUSED = 3, TOO_MANY = 4, MISSING = 5 };

typedef struct {
    long instants, edges, nodes, roots, breaks, same_time;
    const double *t, *W, *constant, *terms;         /* of the instants in sight */
    const unsigned char *reachable;
    const double *edge, *piece;                     /* carriers of the last plan: (edges), (4, edges - 1, K) */
    const double *node, *at, *multiplier;           /* its nodes, (3, nodes, K) and (nodes, N) there */
    const double *root, *broken;                    /* singular instants, jumps of the platform's acceleration */
    const double *row_scale, *row, *track, *speed, *acceleration, *jerk, *carrier_force, *effort, *unit, *weight;
    const double *s, *sd;                           /* where the carriers are; NaN where the last plan is to be believed */
    double now, until, step, horizon, spacing, tau, largest, peak;
} Given;

typedef struct {
    long pieces, efforts, forces, missing, rounds, iterations, known;
    double residual, peak, left, largest;
    double node[COUNT], at[3 * LANES], multiplier[COUNT * N];
    double edge[COUNT + K + 1], piece[4 * (COUNT + K) * K];       /* carriers, as (4, pieces, K) */
    double effort_edge[TIMES], effort[2 * TIMES * M];       /* efforts, as (2, efforts, M) */
    double force_edge[INSTANTS], force[2 * INSTANTS * K];
    double missing_time[COUNT + 2 * BORDER + INSTANTS];
} Result;

typedef struct { int node, other; double row[NW], beside[K], value; } Row;   /* of a singular instant */

/* Bounds from above: of rows of one carrier at one node, and of their opposites, in blocks; what few programmes have
   stands at the end. */
enum { ACCELERATION, TRACK, SPEED, FORCE, BLOCKS };
enum { PEAK_AT = 2 * FORCE * LANES, STOP_AT = PEAK_AT + 2 * EFFORTS, LEAST_AT = STOP_AT + 4 * K, OCTET = 8 };
enum { FORCE_AT = (LEAST_AT + OCTET) / OCTET * OCTET, JERK_AT = FORCE_AT + 2 * LANES, EFFORT_AT = JERK_AT + 2 * LANES };
enum { BOUNDS = (EFFORT_AT + 2 * EFFORTS + OCTET - 1) / OCTET * OCTET };

static inline __attribute__((always_inline)) int block_at(int block) { return block < FORCE ? 2 * block * LANES : FORCE_AT; }

typedef struct {
    /* nodes */
    double node[COUNT], h[COUNT];
    int known[COUNT], counts[COUNT], singular[COUNT], is_singular[COUNT], singulars, place[COUNT], beside[2 * COUNT];
    double start, given[3][K], tau_unit;
    /* linear about a plan, in units */
    double at[3][LANES], multiplier[COUNT * N];
    double W[COUNT][N * M], f[COUNT][N], by[COUNT][3][N * K], force[COUNT][K], by_force[COUNT][3][K];
    Row rows[BORDER];
    int borders;
    /* free[i] = M sigma + N z + c of node i, sigma of the one before: rows of sdd, then of tau */
    double motion[COUNT][NF][NV], constant[COUNT][NF], orthonormal[COUNT][N][NF], triangle[COUNT][N][N];
    int directions[COUNT];
    double alpha[COUNT][K], gamma[COUNT][K], delta[COUNT][K];
    /* cost and bounds */
    double cost[LANES][3][3], linear[3][LANES], tau_cost[COUNT], cross[LANES], peak_cost;
    double a[3][BLOCKS][LANES], after[K];
    int bounds, blocks;
    double bound[BOUNDS], active[BOUNDS];
    /* interior point method */
    double x[3][LANES], tau[EFFORTS], peak, nu[BORDER];
    double slack[BOUNDS], dual[BOUNDS], g[BOUNDS], weight[BOUNDS], missing[BOUNDS], change[BOUNDS], push[BOUNDS];
    double dslack[BOUNDS], ddual[BOUNDS], centre[BOUNDS], dx[3][LANES], dtau[EFFORTS], base[COUNT][NW];
    double H[LANES][3][3], tau_H[EFFORTS], crossing[LANES], peak_tau[EFFORTS];
    double feed[COUNT][SIDES][NZ], Qzz[COUNT][NZ][NZ], Qsz[COUNT][NX][NZ], inverse[COUNT][NZ];
    double gradient[SIDES][COUNT][NW], direction[SIDES][COUNT][NW];
} Work;

typedef struct {
    double at[3 * LANES], tau[EFFORTS], multiplier[COUNT * N], left;
    double residual, peak;
    long pieces, efforts, forces;
    double edge[COUNT + K + 1], piece[4 * (COUNT + K) * K];
    double effort_time[TIMES], effort[TIMES * M], force_time[INSTANTS], force[INSTANTS * K];
} Plan;

/* fmax and fmin are calls, for the sake of NaN */
static inline __attribute__((always_inline)) double larger(double a, double b) { return a > b ? a : b; }

static inline __attribute__((always_inline)) double smaller(double a, double b) { return a < b ? a : b; }

static int found(const Given *g, double time) {
    long low = 0, high = g->instants;
    while (low < high) {
        long middle = (low + high) / 2;
        if (g->t[middle] < time - SAME) low = middle + 1; else high = middle;
    }
    return low < g->instants && g->t[low] <= time + SAME ? (int)low : -1;
}

/* s, sd, sdd of piecewise cubics at a time; held after their end. */
static void extended(const double *edge, const double *piece, long pieces, double time, double *s, double *sd, double *sdd) {
    long low = 0, high = pieces;
    while (low < high) {
        long middle = (low + high) / 2;
        if (edge[middle] <= time) low = middle + 1; else high = middle;
    }
    long i = low > 0 ? low - 1 : 0;
    double inside = time < edge[0] ? edge[0] : time > edge[pieces] ? edge[pieces] : time, x = inside - edge[i];
    double moving = time <= edge[pieces];
    for (int j = 0; j < K; j++) {
        double c[4];
        for (int d = 0; d < 4; d++) c[d] = piece[(d * pieces + i) * K + j];
        s[j] = ((c[0] * x + c[1]) * x + c[2]) * x + c[3];
        sd[j] = moving * ((3.0 * c[0] * x + 2.0 * c[1]) * x + c[2]);
        sdd[j] = moving * (6.0 * c[0] * x + 2.0 * c[1]);
    }
}

/* The terms of a carrier's motion, as ``carrier_model.terms``, with first derivatives and the second ones ss, sv, sa, vv. */
static void terms_of(double s, double v, double a, double *value, double (*first)[3], double (*second)[4]) {
    const double own[7] = {s, s * s, v, s * v, a, v * v, s * a};
    const double slope[7][3] = {{1, 0, 0}, {2 * s, 0, 0}, {0, 1, 0}, {v, s, 0}, {0, 0, 1}, {0, 2 * v, 0}, {a, 0, s}};
    const double bend[7][4] = {{0}, {2, 0, 0, 0}, {0}, {0, 1, 0, 0}, {0}, {0, 0, 0, 2}, {0, 0, 1, 0}};
    int count = TERMS < 7 ? TERMS : 7;
    memcpy(value, own, count * sizeof *own);
    memcpy(first, slope, count * sizeof *slope);
    memcpy(second, bend, count * sizeof *bend);
#if TERMS > 7
    for (int i = 1; i < 3; i++) {
        double c = cos(i * s), b = sin(i * s);
        const double wave[2][3] = {{c - 1.0, -i * b, -i * i * c}, {b, i * c, -i * i * b}};
        for (int which = 0; which < 2; which++) {
            const double *w = wave[which];
            int j = 7 + 2 * (i - 1) + which;
            const double values[4] = {w[0], v * w[0], v * v * w[0], a * w[0]};
            const double slopes[4][3] = {
                {w[1], 0, 0}, {v * w[1], w[0], 0}, {v * v * w[1], 2 * v * w[0], 0}, {a * w[1], 0, w[0]}};
            const double bends[4][4] = {
                {w[2], 0, 0, 0}, {v * w[2], w[1], 0, 0}, {v * v * w[2], 2 * v * w[1], 0, 2 * w[0]}, {a * w[2], 0, w[1], 0}};
            for (int kind = 0; kind < 4; kind++, j += 4) {
                value[j] = values[kind];
                memcpy(first[j], slopes[kind], sizeof *slopes);
                memcpy(second[j], bends[kind], sizeof *bends);
            }
        }
    }
#endif
}

static void value_at(const Given *g, int place, const double *s, const double *sd, const double *sdd, double *value) {
    memcpy(value, g->constant + place * (N + K), (N + K) * sizeof *value);
    for (int j = 0; j < K; j++) {
        double phi[TERMS], first[TERMS][3], second[TERMS][4];
        const double *by_term = g->terms + ((long)place * K + j) * TERMS * (N + K);
        terms_of(s[j], sd[j], sdd[j], phi, first, second);
        for (int term = 0; term < TERMS; term++)
            for (int i = 0; i < N + K; i++) value[i] += phi[term] * by_term[term * (N + K) + i];
    }
}

/* Value, slopes (3, N + K, K) and, along y, second derivatives (K, 4). */
static void slopes_at(const Given *g, int place, const double *s, const double *sd, const double *sdd, const double *y,
                      double *value, double (*slope)[(N + K) * K], double (*bend)[4]) {
    memcpy(value, g->constant + place * (N + K), (N + K) * sizeof *value);
    memset(slope, 0, 3 * sizeof *slope);
    if (bend) memset(bend, 0, K * sizeof *bend);
    for (int j = 0; j < K; j++) {
        double phi[TERMS], first[TERMS][3], second[TERMS][4];
        const double *by_term = g->terms + ((long)place * K + j) * TERMS * (N + K);
        terms_of(s[j], sd[j], sdd[j], phi, first, second);
        for (int term = 0; term < TERMS; term++) {
            const double *c = by_term + term * (N + K);
            for (int i = 0; i < N + K; i++) {
                value[i] += phi[term] * c[i];
                for (int d = 0; d < 3; d++) slope[d][i * K + j] += first[term][d] * c[i];
            }
            if (!bend) continue;
            double along = 0.0;
            for (int i = 0; i < N; i++) along += y[i] * c[i];
            for (int d = 0; d < 4; d++) bend[j][d] += second[term][d] * along;
        }
    }
}

/* Eigenvalues and, as columns of V, eigenvectors of a symmetric matrix, by Jacobi's rotations. */
static void eigen(int n, double *A, double *V) {
    for (int i = 0; i < n * n; i++) V[i] = i % (n + 1) == 0;
    for (int sweep = 0; sweep < 30; sweep++) {
        double off = 0.0, on = 0.0;
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) *(i == j ? &on : &off) += A[i * n + j] * A[i * n + j];
        if (off <= 1e-30 * on) return;
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++) {
                double apq = A[p * n + q];
                if (apq == 0.0) continue;
                double theta = 0.5 * (A[q * n + q] - A[p * n + p]) / apq;
                double t = (theta >= 0.0 ? 1.0 : -1.0) / (fabs(theta) + sqrt(theta * theta + 1.0));
                double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
                for (int i = 0; i < n; i++) {
                    double x = A[i * n + p], y = A[i * n + q];
                    A[i * n + p] = c * x - s * y, A[i * n + q] = s * x + c * y;
                }
                for (int i = 0; i < n; i++) {
                    double x = A[p * n + i], y = A[q * n + i];
                    A[p * n + i] = c * x - s * y, A[q * n + i] = s * x + c * y;
                    x = V[i * n + p], y = V[i * n + q];
                    V[i * n + p] = c * x - s * y, V[i * n + q] = s * x + c * y;
                }
            }
    }
}

/* Solve A X = B with rows of B (n, c), by elimination with pivots; 0 where A is singular. */
static int solved(int n, int c, double *A, double *B) {
    for (int p = 0; p < n; p++) {
        int best = p;
        for (int i = p + 1; i < n; i++)
            if (fabs(A[i * n + p]) > fabs(A[best * n + p])) best = i;
        if (!(fabs(A[best * n + p]) > 0.0)) return 0;
        if (best != p) {
            for (int j = 0; j < n; j++) { double x = A[p * n + j]; A[p * n + j] = A[best * n + j]; A[best * n + j] = x; }
            for (int j = 0; j < c; j++) { double x = B[p * c + j]; B[p * c + j] = B[best * c + j]; B[best * c + j] = x; }
        }
        for (int i = p + 1; i < n; i++) {
            double by = A[i * n + p] / A[p * n + p];
            if (by == 0.0) continue;
            for (int j = p; j < n; j++) A[i * n + j] -= by * A[p * n + j];
            for (int j = 0; j < c; j++) B[i * c + j] -= by * B[p * c + j];
        }
    }
    for (int p = n - 1; p >= 0; p--)
        for (int j = 0; j < c; j++) {
            double x = B[p * c + j];
            for (int i = p + 1; i < n; i++) x -= A[p * n + i] * B[i * c + j];
            B[p * c + j] = x / A[p * n + p];
        }
    return 1;
}

/* The nodes of a plan (``nodes_from``). */
static void set_nodes(const Given *g, Work *w) {
    double step = g->step, start = w->start, chosen[BORDER * 4 + COUNT];
    int many = 0, begins = 1;
    chosen[many++] = start;
    for (long r = 0; r < g->roots; r++) {
        double root = g->root[r];
        if (root == start) begins = 0;   /* at a singular instant */
        int kept = root >= start && root <= start + 2.0 * step * COUNT && root > start + APART_SINGULAR * step;
        for (int c = 1; c < many && kept; c++) kept = root - chosen[c] > APART_SINGULAR * step;
        if (kept && many < BORDER * 4) chosen[many++] = root;
    }
    long long first = (long long)floor(2.0 * start / step);
    int count = 0, next = 0;
    for (long long half = first; count < COUNT; half++) {
        double grid = 0.5 * step * (double)half, apart = INFINITY, nearest = INFINITY;
        while (next < many && chosen[next] <= grid && count < COUNT) w->node[count++] = chosen[next++];
        if (count >= COUNT) break;
        for (long r = 0; r < g->roots; r++) apart = smaller(apart, fabs(grid - g->root[r]));
        for (int c = begins; c < many; c++) nearest = smaller(nearest, fabs(grid - chosen[c]));
        double far = grid > start + (NEAR + 1e-6) * step ? 2.0 : 1.0;
        int unit = (int)far * (apart < far * ZONE * step ? 1 : 2);
        if (half % unit == 0 && nearest > APART_OTHER * step && grid > start + SOON * step) w->node[count++] = grid;
    }
    w->singulars = 0;
    for (int i = 0; i < COUNT; i++) {
        w->is_singular[i] = 0;
        for (long r = 0; r < g->roots; r++) w->is_singular[i] |= w->node[i] == g->root[r];
        if (w->is_singular[i]) w->singular[w->singulars++] = i;
        w->h[i] = i + 1 < COUNT ? w->node[i + 1] - w->node[i] : 0.0;
    }
}

/* The instants at which efforts are evaluated (``Ahead.instants``); their number, or -1 where there are too many. */
static int set_instants(const Given *g, const Work *w, double *t) {
    int nodes = 0, count = 0;
    while (nodes < EARLY && w->node[nodes] <= g->until + SAME) nodes++;
    if (!nodes) nodes = 1;
    double first = w->node[0], last = w->node[nodes - 1], broken[INSTANTS / 4];
    int breaks = 0;
    for (long b = 0; b < g->breaks; b++) {
        if (!(g->broken[b] > first + 2.0 * BESIDE && g->broken[b] < last - 2.0 * BESIDE)) continue;
        if (breaks >= INSTANTS / 4) return -1;
        broken[breaks++] = g->broken[b];
    }
    double from = ceil(first / g->spacing), end = ceil(last / g->spacing);
    if (nodes + 2 * breaks + (end - from) > INSTANTS - EARLY - 2) return -1;
    for (int i = 0; i < nodes; i++) t[count++] = w->node[i];
    for (int b = 0; b < breaks; b++) t[count++] = broken[b] - BESIDE, t[count++] = broken[b] + BESIDE;
    for (double i = from; i < end; i++) {
        double grid = g->spacing * i, nearest = INFINITY;
        for (int j = 0; j < nodes; j++) nearest = smaller(nearest, fabs(grid - w->node[j]));
        for (int b = 0; b < breaks; b++) nearest = smaller(nearest, fabs(grid - broken[b]));
        if (nearest > 0.1 * g->spacing) t[count++] = grid;
    }
    for (int i = 1; i < count; i++) {   /* few, and all but the nodes in order */
        double x = t[i];
        int j = i;
        for (; j > 0 && t[j - 1] > x; j--) t[j] = t[j - 1];
        t[j] = x;
    }
    int kept = 0;
    for (int i = 0; i < count; i++)
        if (!i || t[i] != t[kept - 1]) t[kept++] = t[i];
    return kept;
}

/* Where all instants are that a tick needs; those that are not known yet are listed. */
static void look_up(const Given *g, Work *w, Result *result, const double *instants, int count) {
    result->missing = 0;
    for (int i = 0; i < COUNT; i++) {
        double time = smaller(w->node[i], g->until);
        if ((w->place[i] = found(g, time)) < 0) result->missing_time[result->missing++] = time;
    }
    for (int r = 0; r < w->singulars; r++)
        for (int side = 0; side < 2; side++) {
            double time = smaller(w->node[w->singular[r]] + (side ? DIFFERENCE : -DIFFERENCE), g->until);
            if ((w->beside[2 * r + side] = found(g, time)) < 0) result->missing_time[result->missing++] = time;
        }
    for (int i = 0; i < count; i++) {
        double time = smaller(instants[i], g->until);
        if (found(g, time) < 0) result->missing_time[result->missing++] = time;
    }
}

static const double *W_at(const Given *g, int place) { return g->W + (long)place * N * M; }

/* W tau = f and the rows of singular instants, linear about ``w->at`` (``Linearised.about``, ``Programme``). */
static void linearise(const Given *g, Work *w) {
    const double *us = g->unit, *ud = us + K, *ua = ud + K;
    double ut = w->tau_unit;
    for (int i = 0; i < COUNT; i++) {
        double value[N + K], slope[3][(N + K) * K], bend[K][4], along[N];
        for (int r = 0; r < N; r++) along[r] = -w->multiplier[i * N + r];
        const double *at[3] = {w->at[0] + i * K, w->at[1] + i * K, w->at[2] + i * K};
        slopes_at(g, w->place[i], at[0], at[1], at[2], along, value, slope, bend);
        memcpy(w->W[i], W_at(g, w->place[i]), sizeof w->W[i]);
        memcpy(w->f[i], value, sizeof w->f[i]);
        for (int d = 0; d < 3; d++) {
            memcpy(w->by[i][d], slope[d], sizeof w->by[i][d]);
            for (int j = 0; j < K; j++) w->by_force[i][d][j] = slope[d][(N + j) * K + j];
        }
        memcpy(w->force[i], value + N, sizeof w->force[i]);
        for (int j = 0; j < K; j++) {   /* curvature, as far as it is convex */
            const double u[3] = {us[j], ud[j], ua[j]}, *b = bend[j];
            double C[9] = {b[0] * u[0] * u[0], b[1] * u[0] * u[1], b[2] * u[0] * u[2],
                           b[1] * u[0] * u[1], b[3] * u[1] * u[1], 0.0,
                           b[2] * u[0] * u[2], 0.0, 0.0};
            double(*cost)[3] = w->cost[i * K + j];
            memset(cost, 0, sizeof w->cost[0]);
            if (C[2] == 0.0) {   /* two by two */
                double mean = 0.5 * (C[0] + C[4]), half = 0.5 * (C[0] - C[4]), root = hypot(half, C[1]);
                double most = mean + root, least = mean - root;
                if (least >= 0.0) cost[0][0] = C[0], cost[1][1] = C[4], cost[0][1] = cost[1][0] = C[1];
                else if (most > 0.0) {
                    double by = most / (most - least);
                    cost[0][0] = by * (C[0] - least), cost[1][1] = by * (C[4] - least), cost[0][1] = cost[1][0] = by * C[1];
                }
            } else {
                double V[9];
                eigen(3, C, V);
                for (int e = 0; e < 3; e++)
                    for (int p = 0; p < 3; p++)
                        for (int q = 0; q < 3; q++) cost[p][q] += larger(C[e * 4], 0.0) * V[p * 3 + e] * V[q * 3 + e];
            }
            for (int p = 0; p < 3; p++) {
                w->linear[p][i * K + j] = 0.0;
                for (int q = 0; q < 3; q++) w->linear[p][i * K + j] -= cost[p][q] * at[q][j] / u[q];
            }
        }
    }
    w->borders = 0;
    for (int r = 0; r < w->singulars; r++) {
        int q = w->singular[r];
        if (!w->known[q]) continue;
        /* u, that W loses */
        double A[N * N], V[N * N], u[N], rates[2][N + K], slopes[2][3][(N + K) * K], W_rate[M], f_rate = 0.0, by[4][K];
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++) {
                A[i * N + j] = 0.0;
                for (int c = 0; c < M; c++)
                    A[i * N + j] += w->W[q][i * M + c] / g->row_scale[i] * w->W[q][j * M + c] / g->row_scale[j];
            }
        eigen(N, A, V);
        int least = 0;
        for (int i = 1; i < N; i++)
            if (A[i * (N + 1)] < A[least * (N + 1)]) least = i;
        for (int i = 0; i < N; i++) u[i] = V[i * N + least] / g->row_scale[i];
        const double *at[3] = {w->at[0] + q * K, w->at[1] + q * K, w->at[2] + q * K};
        for (int side = 0; side < 2; side++) {
            double s[K], sd[K], h = side ? DIFFERENCE : -DIFFERENCE;
            for (int j = 0; j < K; j++) s[j] = at[0][j] + h * at[1][j], sd[j] = at[1][j] + h * at[2][j];
            slopes_at(g, w->beside[2 * r + side], s, sd, at[2], 0, rates[side], slopes[side], 0);
        }
        const double *W_before = W_at(g, w->beside[2 * r]), *W_after = W_at(g, w->beside[2 * r + 1]);
        double size = 0.0, largest = 0.0;
        for (int c = 0; c < M; c++) {
            W_rate[c] = 0.0;
            for (int i = 0; i < N; i++) W_rate[c] += u[i] * (W_after[i * M + c] - W_before[i * M + c]) / (2.0 * DIFFERENCE);
            size = larger(size, fabs(W_rate[c]));
        }
        for (int i = 0; i < N * M; i++) largest = larger(largest, fabs(w->W[q][i]));
        size = ut * larger(size, 0.1 * largest / g->horizon);
        memset(by, 0, sizeof by);
        for (int i = 0; i < N; i++) {
            f_rate += u[i] * (rates[1][i] - rates[0][i]) / (2.0 * DIFFERENCE);
            for (int d = 0; d < 3; d++)
                for (int j = 0; j < K; j++) {
                    by[d][j] += u[i] * (slopes[1][d][i * K + j] - slopes[0][d][i * K + j]) / (2.0 * DIFFERENCE);
                    by[d + 1][j] += u[i] * w->by[q][d][i * K + j];
                }
        }
        Row base = {.node = q, .other = q};
        for (int c = 0; c < M; c++) base.row[NX + c] = W_rate[c] * ut / size;
        base.value = f_rate / size;
        for (int d = 0; d < 3; d++)
            for (int j = 0; j < K; j++) {
                base.row[d * K + j] = -by[d][j] * g->unit[d * K + j] / size;
                base.value -= by[d][j] * at[d][j] / size;
            }
        double most = 0.0, jerks = 0.0;
        for (int e = 0; e < NW; e++) most = larger(most, fabs(base.row[e]));
        for (int j = 0; j < K; j++) jerks = larger(jerks, fabs(by[3][j] * ua[j] / size / g->step));
        for (int side = -1; side < 2; side++) {   /* before, at the start, after */
            if (side < 0 ? q == 0 : side == 0 ? q > 0 : q + 1 >= COUNT) continue;
            if (side > 0 && jerks < SAME_ROW * most) continue;   /* no jerk counts: that before or at the start says it */
            Row *row = &w->rows[w->borders++];
            *row = base;
            if (!side) {
                long low = 0, high = g->edges;
                while (low < high) {
                    long middle = (low + high) / 2;
                    if (g->edge[middle] < w->node[0]) low = middle + 1; else high = middle;
                }
                long piece = low > 0 ? low - 1 : 0;
                if (piece > g->edges - 2) piece = g->edges - 2;
                for (int j = 0; j < K; j++) row->value += by[3][j] * 6.0 * g->piece[piece * K + j] / size;
                continue;
            }
            row->other = q + side;
            for (int j = 0; j < K; j++) {
                double rate = -side * by[3][j] * ua[j] / size / w->h[side < 0 ? q - 1 : q];
                row->row[2 * K + j] -= rate;
                row->beside[j] = rate;
            }
        }
    }
}

/* What W tau = f leaves free at each node, given the motion before it. 0 where the rows lack rank. */
static int condense(const Given *g, Work *w) {
    const double *us = g->unit, *ud = us + K, *ua = ud + K;
    double ut = w->tau_unit;
    for (int i = 0; i < COUNT; i++) {
        double h = i ? w->h[i - 1] : 0.0, rows[N][NF], by_before[N][NX], right[N];
        double(*motion)[NV] = w->motion[i], *constant = w->constant[i];
        memset(motion, 0, sizeof w->motion[i]);
        memset(constant, 0, sizeof w->constant[i]);
        memset(w->triangle[i], 0, sizeof w->triangle[i]);
        memset(w->orthonormal[i], 0, sizeof w->orthonormal[i]);
        for (int j = 0; j < K; j++) {
            w->alpha[i][j] = h * ud[j] / us[j];
            w->gamma[i][j] = h * h * ua[j] / us[j] / 6.0;
            w->delta[i][j] = 0.5 * h * ua[j] / ud[j];
        }
        int start = i == 0, counted = w->counts[i], rank = 0;
        w->directions[i] = start ? 0 : K;
        if (!counted) {
            for (int j = 0; j < K && !start; j++) motion[j][NX + j] = 1.0;
            continue;
        }
        for (int r = 0; r < N; r++) {
            right[r] = w->f[i][r];
            for (int d = 0; d < 3; d++)
                for (int j = 0; j < K; j++) right[r] -= w->by[i][d][r * K + j] * w->at[d][i * K + j];
            right[r] /= g->row[r];
            for (int j = 0; j < K; j++) {
                double es = -w->by[i][0][r * K + j] * us[j] / g->row[r], ed = -w->by[i][1][r * K + j] * ud[j] / g->row[r];
                double ea = -w->by[i][2][r * K + j] * ua[j] / g->row[r];
                if (start) {   /* all of the motion is given */
                    by_before[r][j] = es, by_before[r][K + j] = ed, by_before[r][2 * K + j] = ea;
                    rows[r][j] = 0.0;
                    continue;
                }
                double alpha = w->alpha[i][j], gamma = w->gamma[i][j], delta = w->delta[i][j];
                by_before[r][j] = es;
                by_before[r][K + j] = es * alpha + ed;
                by_before[r][2 * K + j] = es * 2.0 * gamma + ed * delta;
                rows[r][j] = ea + es * gamma + ed * delta;
            }
            for (int c = 0; c < M; c++) rows[r][K + c] = w->W[i][r * M + c] * ut / g->row[r];
        }
        if (start) {   /* all but the direction that W loses: what the given start leaves of f there is beyond this plan */
            double A[N * N], V[N * N], u[N], norm = 0.0;
            for (int p = 0; p < N; p++)
                for (int q = 0; q < N; q++) {
                    A[p * N + q] = 0.0;
                    for (int c = 0; c < M; c++)
                        A[p * N + q] += w->W[i][p * M + c] / g->row_scale[p] * w->W[i][q * M + c] / g->row_scale[q];
                }
            eigen(N, A, V);
            int least = 0;
            for (int p = 1; p < N; p++)
                if (A[p * (N + 1)] < A[least * (N + 1)]) least = p;
            for (int p = 0; p < N; p++) u[p] = V[p * N + least] / g->row_scale[p] * g->row[p], norm += u[p] * u[p];
            for (int p = 0; p < N; p++) u[p] /= sqrt(norm);
            for (int c = 0; c < NF + NX + 1; c++) {
                double along = 0.0;
                for (int p = 0; p < N; p++) along += u[p] * (c < NF ? rows[p][c] : c < NF + NX ? by_before[p][c - NF] : right[p]);
                for (int p = 0; p < N; p++) *(c < NF ? &rows[p][c] : c < NF + NX ? &by_before[p][c - NF] : &right[p]) -= u[p] * along;
            }
        }
        /* rows = L Q by Gram and Schmidt, twice; the largest row that is left comes next */
        double Q[NF][NF], L[N][N], y[N][NX + 1];
        int done[N];
        memset(done, 0, sizeof done);
        memset(L, 0, sizeof L);
        double scale = 0.0;
        for (int r = 0; r < N; r++)
            for (int c = 0; c < NF; c++) scale = larger(scale, fabs(rows[r][c]));
        for (rank = 0; rank < N; rank++) {
            int best = -1;
            double most = -1.0, rest[N][NF];
            for (int r = 0; r < N; r++) {
                if (done[r]) continue;
                memcpy(rest[r], rows[r], sizeof rest[r]);
                for (int p = 0; p < rank; p++) L[r][p] = 0.0;
                for (int twice = 0; twice < 2; twice++)
                    for (int p = 0; p < rank; p++) {
                        double along = 0.0;
                        for (int c = 0; c < NF; c++) along += Q[p][c] * rest[r][c];
                        for (int c = 0; c < NF; c++) rest[r][c] -= along * Q[p][c];
                        L[r][p] += along;
                    }
                double norm = 0.0;
                for (int c = 0; c < NF; c++) norm += rest[r][c] * rest[r][c];
                if (norm > most) most = norm, best = r;
            }
            if (!(sqrt(most) > 1e-9 * scale)) break;
            done[best] = 1 + rank;
            L[best][rank] = sqrt(most);
            for (int c = 0; c < NF; c++) Q[rank][c] = rest[best][c] / L[best][rank];
        }
        if (rank < (start ? N - 1 : N)) return 0;
        /* free = Qᵀ y, L y = right - by_before sigma */
        for (int p = 0; p < rank; p++) {
            int r = 0;
            while (done[r] != 1 + p) r++;
            for (int c = 0; c < NX; c++) y[p][c] = -by_before[r][c];
            y[p][NX] = right[r];
            for (int o = 0; o < p; o++)
                for (int c = 0; c < NX + 1; c++) y[p][c] -= L[r][o] * y[o][c];
            for (int c = 0; c < NX + 1; c++) y[p][c] /= L[r][p];
            for (int o = 0; o <= p; o++) w->triangle[i][r][o] = L[r][o];
            memcpy(w->orthonormal[i][p], Q[p], sizeof Q[p]);
            for (int e = 0; e < NF; e++) {
                for (int c = 0; c < NX; c++) motion[e][c] += Q[p][e] * y[p][c];
                constant[e] += Q[p][e] * y[p][NX];
            }
        }
        if (rank < N) memset(w->triangle[i], 0, sizeof w->triangle[i]);   /* no multipliers */
        int basis = rank, first = start ? K : 0, free = (start ? M : NF) - rank;
        for (int z = 0; z < free; z++) {   /* the rest of a basis, from the unit vectors of which most is left */
            double most = -1.0, best[NF];
            for (int e = first; e < NF; e++) {
                double rest[NF], norm = 0.0;
                for (int c = 0; c < NF; c++) rest[c] = c == e;
                for (int twice = 0; twice < 2; twice++)
                    for (int p = 0; p < basis; p++) {
                        double along = 0.0;
                        for (int c = 0; c < NF; c++) along += Q[p][c] * rest[c];
                        for (int c = 0; c < NF; c++) rest[c] -= along * Q[p][c];
                    }
                for (int c = 0; c < NF; c++) norm += rest[c] * rest[c];
                if (norm > most) { most = norm; memcpy(best, rest, sizeof best); }
                if (norm > 0.5) break;
            }
            for (int c = 0; c < NF; c++) Q[basis][c] = best[c] / sqrt(most), motion[c][NX + z] = Q[basis][c];
            basis++;
        }
        w->directions[i] = free;
    }
    return 1;
}

static void set_bound(Work *w, int place, double bound) {
    w->active[place] = isfinite(bound) && bound < 1e20;
    w->bound[place] = w->active[place] > 0.0 ? bound : 0.0;
}

static void set_row(Work *w, int block, int lane, double a, double b, double c, double low, double high) {
    w->a[0][block][lane] = a, w->a[1][block][lane] = b, w->a[2][block][lane] = c;
    set_bound(w, block_at(block) + lane, high);
    set_bound(w, block_at(block) + LANES + lane, -low);
}

/* Costs and bounds (``Programme.numbers_of``). 0 where the given start breaks one. */
static int set_programme(const Given *g, Work *w) {
    const double *us = g->unit, *ud = us + K, *ua = ud + K;
    const double *weight = g->weight;
    enum { EFFORT, PEAK, MEMORY, ACCELERATED, JERKED, CENTRE, END, END_SPEED };
    double ut = w->tau_unit, whole = w->node[COUNT - 1] - w->node[0], low[LANES], high[LANES], speed[LANES];
    memset(w->active, 0, sizeof w->active);
    memset(w->bound, 0, sizeof w->bound);
    memset(w->a, 0, sizeof w->a);
    memset(w->cross, 0, sizeof w->cross);
    int few = 1;
    for (int j = 0; j < K; j++) few = few && isinf(g->carrier_force[j]) && isinf(g->jerk[j]);
    for (int c = 0; c < M; c++) few = few && isinf(g->effort[c]);
    w->blocks = few ? FORCE : BLOCKS, w->bounds = few ? FORCE_AT : BOUNDS;
    for (int i = 0; i < COUNT; i++)
        for (int j = 0; j < K; j++) {
            double closer = CLOSER * (w->node[i] - w->node[0]) / whole;
            low[i * K + j] = (g->track[2 * j] + closer * us[j]) / us[j];
            high[i * K + j] = (g->track[2 * j + 1] - closer * us[j]) / us[j];
            speed[i * K + j] = g->speed[j] * (1.0 - closer) / ud[j];
        }
    for (int i = 0; i < COUNT; i++) {
        double share = ((i ? w->h[i - 1] : 0.0) + w->h[i]) / whole;
        double closer = CLOSER * (w->node[i] - w->node[0]) / whole;
        int last = i == COUNT - 1;
        w->tau_cost[i] = weight[EFFORT] * share;
        for (int j = 0; j < K; j++) {
            int lane = i * K + j;
            double(*cost)[3] = w->cost[lane], h = w->h[i], before = i ? w->h[i - 1] : 0.0;
            cost[0][0] += 1e-8 + weight[CENTRE] * share + (last ? 2.0 * weight[END] : 0.0);
            cost[1][1] += 1e-8 + (last ? 2.0 * weight[END_SPEED] : 0.0);
            cost[2][2] += weight[ACCELERATED] * share;
            double by = weight[JERKED] * g->step / g->horizon * g->step;
            if (i) cost[2][2] += 2.0 * by / before;
            if (!last) cost[2][2] += 2.0 * by / h, w->cross[lane] = -2.0 * by / h;
            if (!i) {
                if (w->known[0] && isfinite(g->carrier_force[j])) {   /* all is given */
                    double most = FORCE_KEPT, now = w->force[0][j] / g->carrier_force[j];
                    for (int d = 0; d < 3; d++)
                        now += w->by_force[0][d][j] * (w->x[d][j] * g->unit[d * K + j] - w->at[d][j]) / g->carrier_force[j];
                    if (fabs(now) > most + 1e-9) return 0;
                }
            } else {
                double most = g->acceleration[j] * (1.0 - closer * (IN_HAND / CLOSER)) / ua[j];
                set_row(w, ACCELERATION, lane, 0.0, 0.0, 1.0, -most, most);
                if (isfinite(g->carrier_force[j]) && w->known[i]) {
                    double size = g->carrier_force[j], base = w->force[i][j] / size, kept = FORCE_KEPT - closer, row[3];
                    for (int d = 0; d < 3; d++) {
                        row[d] = w->by_force[i][d][j] * g->unit[d * K + j] / size;
                        base -= w->by_force[i][d][j] * w->at[d][lane] / size;
                    }
                    set_row(w, FORCE, lane, row[0], row[1], row[2], -kept - base, kept - base);
                }
            }
            if (i && !last) {
                double least = smaller(smaller(low[lane - K], low[lane]), low[lane + K]);
                double most = larger(larger(high[lane - K], high[lane]), high[lane + K]);
                set_row(w, TRACK, lane, 1.0, (h - before) * ud[j] / us[j] / 3.0, -h * before * ua[j] / us[j] / 6.0, least, most);
                set_row(w, SPEED, lane, 0.0, 1.0, h * 0.5 * ua[j] / ud[j], -speed[lane], speed[lane]);
            }
            if (last) {
                double fastest = smaller(g->speed[j], sqrt(2.0 * g->acceleration[j] * (g->track[2 * j + 1] - g->track[2 * j])));
                double after = 0.0;
                if (isfinite(fastest) && isfinite(g->acceleration[j]))
                    after = fastest / (2.0 * g->acceleration[j]) * ud[j] / us[j];
                set_row(w, TRACK, lane, 1.0, -before / 3.0 * ud[j] / us[j], 0.0, smaller(low[lane - K], low[lane]), larger(high[lane - K], high[lane]));
                set_row(w, SPEED, lane, 0.0, 1.0, 0.0, -speed[lane], speed[lane]);
                w->after[j] = after;
                for (int back = 0; back < 2; back++) {
                    set_bound(w, STOP_AT + 2 * back * K + j, high[lane]);
                    set_bound(w, STOP_AT + (2 * back + 1) * K + j, -low[lane]);
                }
            } else {
                double most = g->jerk[j] * h / ua[j];
                set_bound(w, JERK_AT + lane, most), set_bound(w, JERK_AT + LANES + lane, most);
            }
        }
        for (int c = 0; c < M; c++) {
            int lane = i * M + c;
            if (!w->counts[i]) continue;
            set_bound(w, PEAK_AT + lane, 0.0), set_bound(w, PEAK_AT + EFFORTS + lane, 0.0);
            set_bound(w, EFFORT_AT + lane, g->effort[c] / ut), set_bound(w, EFFORT_AT + EFFORTS + lane, g->effort[c] / ut);
        }
    }
    set_bound(w, LEAST_AT, -weight[MEMORY] * g->largest / ut);
    w->peak_cost = 1e-8 + 2.0 * weight[PEAK];
    return 1;
}

/* G applied to a motion, efforts and the peak. */
static void apply(const Work *w, const double (*x)[LANES], const double *tau, double peak, double *g) {
    for (int b = 0; b < w->blocks; b++) {
        double *up = g + block_at(b), *down = up + LANES;
        for (int l = 0; l < LANES; l++) {
            double y = w->a[0][b][l] * x[0][l] + w->a[1][b][l] * x[1][l] + w->a[2][b][l] * x[2][l];
            up[l] = y, down[l] = -y;
        }
    }
    for (int l = 0; l < EFFORTS; l++) g[PEAK_AT + l] = tau[l] - peak, g[PEAK_AT + EFFORTS + l] = -tau[l] - peak;
    g[LEAST_AT] = -peak;
    for (int j = 0; j < K; j++) {
        double s = x[0][LANES - K + j], gone = w->after[j] * x[1][LANES - K + j], *stop = g + STOP_AT + j;
        stop[0] = s + gone, stop[K] = -s - gone, stop[2 * K] = s - gone, stop[3 * K] = gone - s;
    }
    if (w->blocks < BLOCKS) return;
    for (int l = 0; l < LANES - K; l++) {
        double y = x[2][l + K] - x[2][l];
        g[JERK_AT + l] = y, g[JERK_AT + LANES + l] = -y;
    }
    for (int l = 0; l < EFFORTS; l++) g[EFFORT_AT + l] = tau[l], g[EFFORT_AT + EFFORTS + l] = -tau[l];
}

/* Add Gᵀ v to a gradient by nodes; return its part for the peak. */
static double add_transposed(const Work *w, const double *v, double (*gradient)[NW]) {
    double by_peak = -v[LEAST_AT], sum[3][LANES];
    memset(sum, 0, sizeof sum);
    for (int b = 0; b < w->blocks; b++) {
        const double *up = v + block_at(b), *down = up + LANES;
        for (int d = 0; d < 3; d++)
            for (int l = 0; l < LANES; l++) sum[d][l] += w->a[d][b][l] * (up[l] - down[l]);
    }
    int many = w->blocks == BLOCKS;
    for (int l = 0; l < LANES - K && many; l++) {
        double y = v[JERK_AT + l] - v[JERK_AT + LANES + l];
        sum[2][l + K] += y, sum[2][l] -= y;
    }
    for (int j = 0; j < K; j++) {
        const double *stop = v + STOP_AT + j, out = stop[0] - stop[K], back = stop[2 * K] - stop[3 * K];
        sum[0][LANES - K + j] += out + back, sum[1][LANES - K + j] += w->after[j] * (out - back);
    }
    for (int i = 0; i < COUNT; i++) {
        for (int d = 0; d < 3; d++)
            for (int j = 0; j < K; j++) gradient[i][d * K + j] += sum[d][i * K + j];
        for (int c = 0; c < M; c++) {
            int l = i * M + c;
            gradient[i][NX + c] += v[PEAK_AT + l] - v[PEAK_AT + EFFORTS + l];
            if (many) gradient[i][NX + c] += v[EFFORT_AT + l] - v[EFFORT_AT + EFFORTS + l];
            by_peak -= v[PEAK_AT + l] + v[PEAK_AT + EFFORTS + l];
        }
    }
    return by_peak;
}

/* Gradient of the cost at the point so far, with the multipliers of the border; return its part for the peak. */
static double set_gradient(const Work *w, double (*gradient)[NW]) {
    for (int i = 0; i < COUNT; i++) {
        for (int j = 0; j < K; j++) {
            int l = i * K + j;
            for (int p = 0; p < 3; p++) {
                double y = w->linear[p][l];
                for (int q = 0; q < 3; q++) y += w->cost[l][p][q] * w->x[q][l];
                gradient[i][p * K + j] = y;
            }
            if (i + 1 < COUNT) gradient[i][2 * K + j] += w->cross[l] * w->x[2][l + K];
            if (i) gradient[i][2 * K + j] += w->cross[l - K] * w->x[2][l - K];
        }
        for (int c = 0; c < M; c++) gradient[i][NX + c] = w->tau_cost[i] * w->tau[i * M + c];
    }
    for (int b = 0; b < w->borders; b++) {
        const Row *row = &w->rows[b];
        for (int e = 0; e < NW; e++) gradient[row->node][e] += w->nu[b] * row->row[e];
        for (int j = 0; j < K; j++) gradient[row->other][2 * K + j] += w->nu[b] * row->beside[j];
    }
    return w->peak_cost * w->peak;
}

/* s and sd of a node follow from the motion sigma before it and from its own sdd y, all in units:

       s' = s + alpha sd + 2 gamma sdd + gamma y,    sd' = sd + delta (sdd + y).

   Of a gradient by the motion of the node, x, these are the parts by sigma (added) and by y. */
static inline __attribute__((always_inline)) void bring_back(const Work *w, int i, const double *x, double *sigma, double *y) {
    for (int j = 0; j < K; j++) {
        double a = w->alpha[i][j], c = w->gamma[i][j], d = w->delta[i][j];
        y[j] = c * x[j] + d * x[K + j] + x[2 * K + j];
        sigma[j] += x[j];
        sigma[K + j] += a * x[j] + x[K + j];
        sigma[2 * K + j] += 2.0 * c * x[j] + d * x[K + j];
    }
}

/* The Riccati recursion; 0 where a step of it is not positive. */
static int factorise(Work *w) {
    double P[NX][NX];
    memset(P, 0, sizeof P);
    for (int i = COUNT - 1; i >= 0; i--) {
        const double(*free)[NV] = w->motion[i], *tau_H = w->tau_H + i * M;
        double by_sigma[NX][NX], by_y[NX][K], both[NX][K], own[K][K], R[NF][NV], Q[NV][NV];
        for (int d = 0; d < 3; d++)
            for (int e = 0; e < 3; e++)
                for (int j = 0; j < K; j++) P[d * K + j][e * K + j] += w->H[i * K + j][d][e];
        memset(Q, 0, sizeof Q);
        if (i) {
            double turned[NX][NX], corner[K][NX];
            memset(by_sigma, 0, sizeof by_sigma);
            for (int r = 0; r < NX; r++) bring_back(w, i, P[r], by_sigma[r], by_y[r]);
            for (int r = 0; r < NX; r++)
                for (int c = 0; c < NX; c++) turned[c][r] = by_sigma[r][c];
            for (int r = 0; r < NX; r++) {
                double y[K], sigma[NX];
                memset(sigma, 0, sizeof sigma);
                bring_back(w, i, turned[r], sigma, y);
                for (int c = 0; c < NX; c++) Q[r][c] = sigma[c];
                for (int j = 0; j < K; j++) both[r][j] = y[j];
            }
            for (int c = 0; c < K; c++)
                for (int r = 0; r < NX; r++) corner[c][r] = by_y[r][c];
            for (int c = 0; c < K; c++) {
                double unused[NX];
                memset(unused, 0, sizeof unused);
                bring_back(w, i, corner[c], unused, own[c]);
            }
            for (int j = 0; j < K; j++) both[2 * K + j][j] += w->crossing[(i - 1) * K + j];   /* with sdd before it */
            for (int j = 0; j < K; j++)
                for (int c = 0; c < NV; c++) {
                    double x = 0.0;
                    for (int l = 0; l < K; l++) x += own[j][l] * free[l][c];
                    R[j][c] = 0.5 * x;
                }
            for (int j = 0; j < K; j++)
                for (int c = 0; c < NX; c++) R[j][c] += both[c][j];
        } else
            memset(R, 0, sizeof R);   /* its motion is given */
        for (int t = 0; t < M; t++)
            for (int c = 0; c < NV; c++) R[K + t][c] = 0.5 * tau_H[t] * free[K + t][c];
        double half[NV][NV];
        for (int r = 0; r < NV; r++)
            for (int c = 0; c < NV; c++) half[r][c] = free[0][r] * R[0][c];
        for (int e = 1; e < NF; e++)
            for (int r = 0; r < NV; r++)
                for (int c = 0; c < NV; c++) half[r][c] += free[e][r] * R[e][c];
        for (int r = 0; r < NV; r++)
            for (int c = 0; c < NV; c++) Q[r][c] += half[r][c] + half[c][r];
        double(*L)[NZ] = w->Qzz[i], (*S)[NZ] = w->Qsz[i];
        for (int p = 0; p < NZ; p++)
            for (int c = 0; c < NZ; c++)
                L[p][c] = p < w->directions[i] && c < w->directions[i] ? Q[NX + p][NX + c] : p == c;
        for (int p = 0; p < NZ; p++) {
            for (int o = 0; o < p; o++) L[p][p] -= L[p][o] * L[p][o];
            if (!(L[p][p] > 0.0)) return 0;
            L[p][p] = sqrt(L[p][p]), w->inverse[i][p] = 1.0 / L[p][p];
            for (int r = p + 1; r < NZ; r++) {
                for (int o = 0; o < p; o++) L[r][p] -= L[r][o] * L[p][o];
                L[r][p] *= w->inverse[i][p];
            }
        }
        for (int c = 0; c < NX; c++)   /* S = Qsz L⁻ᵀ */
            for (int p = 0; p < NZ; p++) {
                double x = p < w->directions[i] ? Q[c][NX + p] : 0.0;
                for (int o = 0; o < p; o++) x -= L[p][o] * S[c][o];
                S[c][p] = x * w->inverse[i][p];
            }
        for (int r = 0; r < NX; r++)
            for (int c = 0; c < NX; c++) {
                double x = Q[r][c];
                for (int p = 0; p < NZ; p++) x -= S[r][p] * S[c][p];
                P[r][c] = x;
            }
    }
    return 1;
}

/* A gradient by nodes (`own`, and what the nodes after it add) by what is free at one: [sigma, z]. */
static inline __attribute__((always_inline)) void gather(const Work *w, int i, const double *own, const double *carried, double *q) {
    double x[NX], free[NF], sigma[NX];
    memset(sigma, 0, sizeof sigma);
    memset(q, 0, NV * sizeof *q);
    for (int c = 0; c < NX; c++) x[c] = own[c] + carried[c];
    bring_back(w, i, x, sigma, free);
    for (int c = 0; c < NX && i; c++) q[c] = sigma[c];
    for (int c = 0; c < M; c++) free[K + c] = own[NX + c];
    for (int e = i ? 0 : K; e < NF; e++)
        for (int c = 0; c < NV; c++) q[c] += free[e] * w->motion[i][e][c];
}

/* Steps against gradients, of ``sides`` right sides. */
static void step_against(Work *w, int sides) {
    double carried[SIDES][NX];
    memset(carried, 0, sizeof carried);
    for (int i = COUNT - 1; i >= 0; i--)
        for (int s = 0; s < sides; s++) {
            double q[NV], *k = w->feed[i][s];
            gather(w, i, w->gradient[s][i], carried[s], q);
            for (int p = 0; p < NZ; p++) {   /* L⁻¹ q */
                double x = p < w->directions[i] ? q[NX + p] : 0.0;
                for (int o = 0; o < p; o++) x -= w->Qzz[i][p][o] * k[o];
                k[p] = x * w->inverse[i][p];
            }
            for (int c = 0; c < NX; c++) {
                double x = q[c];
                for (int p = 0; p < NZ; p++) x -= w->Qsz[i][c][p] * k[p];
                carried[s][c] = x;
            }
        }
    for (int s = 0; s < sides; s++) {
        double z[NV];
        memset(z, 0, sizeof z);
        for (int i = 0; i < COUNT; i++) {
            double *out = w->direction[s][i];
            for (int p = NZ - 1; p >= 0; p--) {   /* L⁻ᵀ (-k - Sᵀ sigma) */
                double x = -w->feed[i][s][p];
                for (int c = 0; c < NX; c++) x -= w->Qsz[i][c][p] * z[c];
                for (int o = p + 1; o < NZ; o++) x -= w->Qzz[i][o][p] * z[NX + o];
                z[NX + p] = x * w->inverse[i][p];
            }
            for (int p = w->directions[i]; p < NZ; p++) z[NX + p] = 0.0;
            for (int e = 0; e < NF; e++) {
                double x = 0.0;
                for (int c = 0; c < NV; c++) x += w->motion[i][e][c] * z[c];
                out[2 * K + e] = x;
            }
            for (int j = 0; j < K; j++) {
                double y = i ? out[2 * K + j] : 0.0, a = w->alpha[i][j], c = w->gamma[i][j], d = w->delta[i][j];
                out[j] = i ? z[j] + a * z[K + j] + c * (2.0 * z[2 * K + j] + y) : 0.0;
                out[K + j] = i ? z[K + j] + d * (z[2 * K + j] + y) : 0.0;
                out[2 * K + j] = y;
            }
            memcpy(z, out, NX * sizeof *z);
        }
    }
}

static double along_row(const Row *row, const double (*v)[NW]) {
    double x = 0.0;
    for (int e = 0; e < NW; e++) x += row->row[e] * v[row->node][e];
    for (int j = 0; j < K; j++) x += row->beside[j] * v[row->other][2 * K + j];
    return x;
}

/* A first point: sdd as near as it may be to those of the plan that all is linear about. */
static void begin(const Given *g, Work *w) {
    const double *ua = g->unit + 2 * K;
    for (int i = 0; i < COUNT; i++) {
        double z[NV], free[NF], A[NZ * NZ], rhs[NZ];
        memset(z, 0, sizeof z);
        if (i)
            for (int d = 0; d < 3; d++)
                for (int j = 0; j < K; j++) z[d * K + j] = w->x[d][(i - 1) * K + j];
        for (int e = 0; e < NF; e++) {
            free[e] = w->constant[i][e];
            for (int c = 0; c < NX; c++) free[e] += w->motion[i][e][c] * (i ? z[c] : w->x[c / K][c % K]);
        }
        for (int p = 0; p < NZ; p++) {
            rhs[p] = 0.0;
            for (int o = 0; o < NZ; o++) A[p * NZ + o] = p == o ? DAMPING : 0.0;
            if (p >= w->directions[i] || !i) continue;
            for (int j = 0; j < K; j++) {
                double own = w->motion[i][j][NX + p];
                int limit = block_at(ACCELERATION) + i * K + j;
                double aim = w->at[2][i * K + j] / ua[j], most = WITHIN * w->bound[limit];
                if (w->active[limit] > 0.0) aim = larger(-most, smaller(aim, most));   /* past its end it was to stop */
                rhs[p] += own * (aim - free[j]);
                for (int o = 0; o < w->directions[i]; o++) A[p * NZ + o] += own * w->motion[i][j][NX + o];
            }
        }
        solved(NZ, 1, A, rhs);
        for (int e = 0; e < NF; e++)
            for (int p = 0; p < w->directions[i]; p++) free[e] += w->motion[i][e][NX + p] * rhs[p];
        for (int c = 0; c < M; c++) w->tau[i * M + c] = w->counts[i] ? free[K + c] : 0.0;
        if (!i) continue;
        for (int j = 0; j < K; j++) {
            int l = i * K + j;
            double alpha = w->alpha[i][j], gamma = w->gamma[i][j], delta = w->delta[i][j];
            w->x[2][l] = free[j];
            w->x[1][l] = w->x[1][l - K] + delta * (w->x[2][l - K] + free[j]);
            w->x[0][l] = w->x[0][l - K] + alpha * w->x[1][l - K] + gamma * (2.0 * w->x[2][l - K] + free[j]);
        }
    }
    w->peak = -w->bound[LEAST_AT];
    for (int l = 0; l < EFFORTS; l++) w->peak = larger(w->peak, fabs(w->tau[l]));
    w->peak += ROOM;
    memset(w->nu, 0, sizeof w->nu);
    apply(w, w->x, w->tau, w->peak, w->g);
    double beyond = 0.0, barrier;
    for (int c = 0; c < w->bounds; c++) beyond = larger(beyond, w->active[c] * (w->g[c] - w->bound[c]));
    barrier = beyond < GOOD ? GOOD_BARRIER : FIRST_BARRIER;
    for (int c = 0; c < w->bounds; c++) {
        w->slack[c] = w->active[c] > 0.0 ? larger(w->bound[c] - w->g[c], ROOM) : 1.0;
        w->dual[c] = w->active[c] > 0.0 ? barrier / w->slack[c] : 1.0;
    }
}

/* The largest step, up to 1, that keeps slacks and duals positive. */
static double longest(const Work *w, const double *inverse) {
    double most[OCTET], longest = 1.0;
    for (int o = 0; o < OCTET; o++) most[o] = 1.0;
    for (int c = 0; c < w->bounds; c += OCTET)   /* lanes, as of vectors */
        for (int o = 0; o < OCTET; o++) {
            double slack = -w->dslack[c + o] * inverse[c + o], dual = -w->ddual[c + o] / w->dual[c + o];
            most[o] = larger(most[o], larger(slack, dual));
        }
    for (int o = 0; o < OCTET; o++) longest = larger(longest, most[o]);
    return 1.0 / longest;
}

/* The direction against gradient 0 and the missing rows; its change of every bound. */
static int direct(Work *w, double peak_gradient, double peak_H, double *dpeak, double *dnu) {
    int size = 1 + w->borders;
    double S[SIDES * SIDES], right[SIDES];
    const double(*first)[NW] = w->direction[0];
    for (int r = 0; r < size; r++) {
        for (int s = 0; s <= size; s++) {   /* the last: gradient 0 */
            const double(*v)[NW] = s < size ? w->direction[1 + s] : first;
            double x = 0.0;
            if (!r) {
                for (int i = 0; i < COUNT; i++)
                    for (int c = 0; c < M; c++) x += w->peak_tau[i * M + c] * v[i][NX + c];
            } else
                x = along_row(&w->rows[r - 1], v);
            if (s < size) S[r * size + s] = x; else right[r] = -x;
        }
    }
    S[0] += peak_H;
    right[0] -= peak_gradient;
    for (int b = 0; b < w->borders; b++) {
        const Row *row = &w->rows[b];
        S[(b + 1) * (size + 1)] -= 1e-13;
        right[b + 1] += row->value;
        for (int j = 0; j < K; j++) {
            for (int d = 0; d < 3; d++) right[b + 1] -= row->row[d * K + j] * w->x[d][row->node * K + j];
            right[b + 1] -= row->beside[j] * w->x[2][row->other * K + j];
        }
        for (int c = 0; c < M; c++) right[b + 1] -= row->row[NX + c] * w->tau[row->node * M + c];
    }
    if (!solved(size, 1, S, right)) return 0;
    *dpeak = right[0];
    memcpy(dnu, right + 1, w->borders * sizeof *dnu);
    double dtau[EFFORTS];
    for (int i = 0; i < COUNT; i++) {
        double whole[NW];
        memcpy(whole, first[i], sizeof whole);
        for (int s = 0; s < size; s++)
            for (int e = 0; e < NW; e++) whole[e] += right[s] * w->direction[1 + s][i][e];
        for (int d = 0; d < 3; d++)
            for (int j = 0; j < K; j++) w->dx[d][i * K + j] = whole[d * K + j];
        for (int c = 0; c < M; c++) dtau[i * M + c] = whole[NX + c];
    }
    memcpy(w->dtau, dtau, sizeof dtau);
    apply(w, w->dx, dtau, *dpeak, w->change);
    return 1;
}

/* Whether the gradient with the duals, brought back along the motion, is rounding; ``base`` has it without them. */
static int is_stationary(Work *w, double base_peak) {
    double carried[NX], q[NV], size = 1.0, left;
    for (int c = 0; c < w->bounds; c++) w->centre[c] = w->active[c] * w->dual[c];
    memcpy(w->gradient[1], w->base, sizeof w->base);
    left = fabs(base_peak + add_transposed(w, w->centre, w->gradient[1]));
    memset(carried, 0, sizeof carried);
    for (int i = COUNT - 1; i >= 0; i--) {
        for (int r = 0; r < NW; r++) size = larger(size, fabs(w->gradient[1][i][r] + (r < NX ? carried[r] : 0.0)));
        gather(w, i, w->gradient[1][i], carried, q);
        for (int z = 0; z < w->directions[i]; z++) left = larger(left, fabs(q[NX + z]));
        memcpy(carried, q, sizeof carried);
    }
    return left < STATIONARY * size;
}

/* Mehrotra's predictor and corrector; the number of iterations, or 0 where no optimum is found. */
static int interior_point(const Given *g, Work *w) {
    begin(g, w);
    double count = 0.0, inverse[BOUNDS];
    for (int c = 0; c < w->bounds; c++) count += w->active[c];
    for (int iteration = 1; iteration <= ITERATIONS; iteration++) {
        double barrier = 0.0, most = 0.0, peak_H = w->peak_cost, rows = 0.0, sum[OCTET], worst[OCTET];
        memset(sum, 0, sizeof sum);
        memset(worst, 0, sizeof worst);
        apply(w, w->x, w->tau, w->peak, w->g);
        for (int at = 0; at < w->bounds; at += OCTET)
            for (int o = 0; o < OCTET; o++) {
                int c = at + o;
                double missing = w->active[c] * (w->g[c] - w->bound[c] + w->slack[c]);
                inverse[c] = 1.0 / w->slack[c];
                w->weight[c] = w->active[c] * w->dual[c] * inverse[c];
                w->missing[c] = missing, w->push[c] = w->weight[c] * missing;
                sum[o] += w->active[c] * w->slack[c] * w->dual[c];
                worst[o] = larger(worst[o], fabs(missing));
            }
        for (int o = 0; o < OCTET; o++) barrier += sum[o] / count, most = larger(most, worst[o]);
        if (!(barrier < 1e12)) return 0;
        for (int l = 0; l < LANES; l++) {
            memcpy(w->H[l], w->cost[l], sizeof w->H[l]);
            w->crossing[l] = w->cross[l];
        }
        for (int b = 0; b < w->blocks; b++) {
            const double *up = w->weight + block_at(b), *down = up + LANES;
            for (int l = 0; l < LANES; l++) {
                double both = up[l] + down[l];
                for (int p = 0; p < 3; p++)
                    for (int q = 0; q < 3; q++) w->H[l][p][q] += both * w->a[p][b][l] * w->a[q][b][l];
            }
        }
        for (int j = 0; j < K; j++) {
            const double *stop = w->weight + STOP_AT + j, out = stop[0] + stop[K], back = stop[2 * K] + stop[3 * K];
            double(*H)[3] = w->H[LANES - K + j], after = w->after[j];
            H[0][0] += out + back, H[1][1] += after * after * (out + back);
            H[0][1] += after * (out - back), H[1][0] += after * (out - back);
        }
        int many = w->blocks == BLOCKS;
        for (int l = 0; l < LANES - K && many; l++) {
            double both = w->weight[JERK_AT + l] + w->weight[JERK_AT + LANES + l];
            w->H[l][2][2] += both, w->H[l + K][2][2] += both, w->crossing[l] -= both;
        }
        for (int l = 0; l < EFFORTS; l++) {
            double up = w->weight[PEAK_AT + l], down = w->weight[PEAK_AT + EFFORTS + l];
            w->tau_H[l] = w->tau_cost[l / M] + up + down;
            if (many) w->tau_H[l] += w->weight[EFFORT_AT + l] + w->weight[EFFORT_AT + EFFORTS + l];
            w->peak_tau[l] = down - up;
            peak_H += up + down;
        }
        peak_H += w->weight[LEAST_AT];
        if (!factorise(w)) return 0;
        double peak_gradient = set_gradient(w, w->gradient[0]), dpeak = 0.0, dnu[BORDER];
        for (int b = 0; b < w->borders; b++) {
            const Row *row = &w->rows[b];
            double x = row->value;
            for (int j = 0; j < K; j++) {
                for (int d = 0; d < 3; d++) x -= row->row[d * K + j] * w->x[d][row->node * K + j];
                x -= row->beside[j] * w->x[2][row->other * K + j];
            }
            for (int c = 0; c < M; c++) x -= row->row[NX + c] * w->tau[row->node * M + c];
            rows = larger(rows, fabs(x));
        }
        memcpy(w->base, w->gradient[0], sizeof w->base);
        double base_peak = peak_gradient;
        if (barrier < BARRIER && most < PRECISION && rows < PRECISION && is_stationary(w, base_peak)) return iteration;
        peak_gradient = base_peak + add_transposed(w, w->push, w->gradient[0]);
        int sides = 2 + w->borders;
        for (int s = 1; s < sides; s++) memset(w->gradient[s], 0, sizeof w->gradient[s]);
        for (int i = 0; i < COUNT; i++)
            for (int c = 0; c < M; c++) w->gradient[1][i][NX + c] = w->peak_tau[i * M + c];
        for (int b = 0; b < w->borders; b++) {
            const Row *row = &w->rows[b];
            memcpy(w->gradient[2 + b][row->node], row->row, sizeof row->row);
            for (int j = 0; j < K; j++) w->gradient[2 + b][row->other][2 * K + j] += row->beside[j];
        }
        step_against(w, sides);
        if (!direct(w, peak_gradient, peak_H, &dpeak, dnu)) return 0;
        for (int c = 0; c < w->bounds; c++) {
            w->dslack[c] = -w->missing[c] - w->active[c] * w->change[c];
            w->ddual[c] = w->active[c] * (-w->dual[c] - w->weight[c] * w->dslack[c]);
        }
        double alpha = longest(w, inverse), after = 0.0;
        memset(sum, 0, sizeof sum);
        for (int at = 0; at < w->bounds; at += OCTET)
            for (int o = 0; o < OCTET; o++) {
                int c = at + o;
                sum[o] += w->active[c] * (w->slack[c] + alpha * w->dslack[c]) * (w->dual[c] + alpha * w->ddual[c]);
            }
        for (int o = 0; o < OCTET; o++) after += sum[o] / count;
        double sigma = pow(after / barrier, 3.0), aim = larger(sigma * barrier, 0.1 * BARRIER);
        for (int c = 0; c < w->bounds; c++) {
            w->centre[c] = w->active[c] * (aim - alpha * w->dslack[c] * w->ddual[c]) * inverse[c];
            w->push[c] += w->centre[c];
        }
        memcpy(w->gradient[0], w->base, sizeof w->base);
        peak_gradient = base_peak + add_transposed(w, w->push, w->gradient[0]);
        step_against(w, 1);
        if (!direct(w, peak_gradient, peak_H, &dpeak, dnu)) return 0;
        for (int c = 0; c < w->bounds; c++) {
            w->dslack[c] = -w->missing[c] - w->active[c] * w->change[c];
            w->ddual[c] = w->active[c] * (w->centre[c] - w->dual[c] - w->weight[c] * w->dslack[c]);
        }
        alpha = longest(w, inverse);
        alpha = alpha < 1.0 ? alpha * CLOSE : 1.0;
        if (alpha < 1e-8) return 0;
        for (int d = 0; d < 3; d++)
            for (int l = 0; l < LANES; l++) w->x[d][l] += alpha * w->dx[d][l];
        for (int l = 0; l < EFFORTS; l++) w->tau[l] += alpha * w->dtau[l];
        w->peak += alpha * dpeak;
        for (int b = 0; b < w->borders; b++) w->nu[b] += alpha * dnu[b];
        for (int c = 0; c < w->bounds; c++) w->slack[c] += alpha * w->dslack[c], w->dual[c] += alpha * w->ddual[c];
    }
    return 0;
}

/* The multipliers of W tau = f. */
static void set_multipliers(const Given *g, Work *w, double *multiplier) {
    double(*gradient)[NW] = w->gradient[0], carried[NX];
    set_gradient(w, gradient);
    for (int c = 0; c < w->bounds; c++) w->push[c] = w->active[c] * w->dual[c];
    add_transposed(w, w->push, gradient);
    memset(carried, 0, sizeof carried);
    memset(multiplier, 0, COUNT * N * sizeof *multiplier);
    for (int i = COUNT - 1; i > 0; i--) {
        double x[NX], free[NF], sigma[NX], q[NV], A[N * N], y[N];
        memset(sigma, 0, sizeof sigma);
        for (int c = 0; c < NX; c++) x[c] = gradient[i][c] + carried[c];
        bring_back(w, i, x, sigma, free);
        memcpy(free + K, gradient[i] + NX, M * sizeof *free);
        gather(w, i, gradient[i], carried, q);
        memcpy(carried, q, sizeof carried);
        if (!w->counts[i]) continue;
        for (int o = 0; o < N; o++) {
            y[o] = 0.0;
            for (int e = 0; e < NF; e++) y[o] -= w->orthonormal[i][o][e] * free[e];
            for (int r = 0; r < N; r++) A[o * N + r] = w->triangle[i][r][o];
        }
        if (solved(N, 1, A, y))
            for (int r = 0; r < N; r++) multiplier[i * N + r] = y[r] / g->row[r];
    }
}

/* The carriers' motion, and a stop behind it (``with_stop``). */
static void set_pieces(const Given *g, const Work *w, Plan *plan) {
    double after[K + 1], duration[K];
    int stops = 1, last = COUNT - 1;
    after[0] = 0.0;
    for (int j = 0; j < K; j++) {
        duration[j] = fabs(plan->at[LANES + last * K + j]) / g->acceleration[j];
        if (duration[j] < SHORTEST_STOP) duration[j] = 0.0;
        int i = stops, same = 0;
        for (int o = 0; o < stops; o++) same |= after[o] == duration[j];
        if (same) continue;
        for (; after[i - 1] > duration[j]; i--) after[i] = after[i - 1];
        after[i] = duration[j];
        stops++;
    }
    long pieces = last + stops - 1;
    plan->pieces = pieces;
    for (long i = 0; i < pieces; i++) {
        long stop = i - last;
        plan->edge[i] = stop < 0 ? w->node[i] : w->node[last] + after[stop];
        for (int j = 0; j < K; j++) {
            double s, sd, sdd, jerk = 0.0;
            if (stop < 0) {
                int l = (int)i * K + j;
                s = plan->at[l], sd = plan->at[LANES + l], sdd = plan->at[2 * LANES + l];
                jerk = (plan->at[2 * LANES + l + K] - sdd) / w->h[i];
            } else {
                int l = last * K + j;
                double end = plan->at[LANES + l], past = smaller(after[stop], duration[j]);
                double a = duration[j] > 0.0 ? -end / duration[j] : 0.0, slowing = after[stop] < duration[j];
                s = plan->at[l] + past * end + 0.5 * past * past * a;
                sd = (end + past * a) * slowing, sdd = a * slowing;
            }
            double *c = plan->piece + i * K + j;
            c[0] = jerk / 6.0, c[pieces * K] = sdd / 2.0, c[2 * pieces * K] = sd, c[3 * pieces * K] = s;
        }
    }
    plan->edge[pieces] = w->node[last] + after[stops - 1];
}

/* Efforts and carriers' forces in the first steps (``_efforts``). */
static void set_efforts(const Given *g, const Work *w, const double *t, int count, Plan *plan) {
    int fine[INSTANTS], at_node[EARLY];
    double value[INSTANTS][N + K], own[INSTANTS][M];
    plan->residual = plan->peak = 0.0;
    for (int i = 0; i < COUNT; i++)
        for (int c = 0; c < M && w->counts[i]; c++) plan->peak = larger(plan->peak, fabs(plan->tau[i * M + c]));
    for (int e = 0; e < EARLY; e++) {
        int place = 0;
        while (place < count - 1 && t[place] < w->node[e] - SAME) place++;
        at_node[e] = place;
    }
    plan->forces = count;
    for (int p = 0; p < count; p++) {
        double s[K], sd[K], sdd[K];
        int place = found(g, smaller(t[p], g->until));
        const double *W = W_at(g, place);
        extended(plan->edge, plan->piece, plan->pieces, t[p], s, sd, sdd);
        value_at(g, place, s, sd, sdd, value[p]);
        plan->force_time[p] = t[p];
        memcpy(plan->force + p * K, value[p] + N, K * sizeof(double));
        /* singular values: roots of the eigenvalues of W Wᵀ */
        double A[N * N], V[N * N], least = INFINITY, most = 0.0;
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++) {
                A[i * N + j] = 0.0;
                for (int c = 0; c < M; c++) A[i * N + j] += W[i * M + c] / g->row_scale[i] * W[j * M + c] / g->row_scale[j];
            }
        eigen(N, A, V);
        for (int i = 0; i < N; i++) least = smaller(least, A[i * (N + 1)]), most = larger(most, A[i * (N + 1)]);
        fine[p] = least > REGULAR * REGULAR * most;
        if (!fine[p]) continue;
        double B[N * N], right[N], planned[M];
        memset(planned, 0, sizeof planned);
        if (M == N) {
            memcpy(B, W, sizeof B);
            memcpy(right, value[p], sizeof right);
            fine[p] = solved(N, 1, B, right);
            memcpy(own[p], right, N * sizeof(double));
            continue;
        }
        int i = 0;   /* what redundant actuators do beside is planned */
        while (i < COUNT - 2 && w->node[i + 1] <= t[p]) i++;
        double fraction = (t[p] - w->node[i]) / (w->node[i + 1] - w->node[i]);
        fraction = smaller(larger(fraction, 0.0), 1.0);
        for (int c = 0; c < M; c++) {
            int from = i == 0 && !w->counts[0] ? 1 : i;
            planned[c] = plan->tau[from * M + c] * (1.0 - fraction) + plan->tau[(i + 1) * M + c] * fraction;
        }
        for (int r = 0; r < N; r++) {
            right[r] = value[p][r];
            for (int c = 0; c < M; c++) right[r] -= W[r * M + c] * planned[c];
            for (int q = 0; q < N; q++) {
                B[r * N + q] = 0.0;
                for (int c = 0; c < M; c++) B[r * N + q] += W[r * M + c] * W[q * M + c];
            }
        }
        fine[p] = solved(N, 1, B, right);
        for (int c = 0; c < M; c++) {
            own[p][c] = planned[c];
            for (int r = 0; r < N; r++) own[p][c] += W[r * M + c] * right[r];
        }
    }
    for (int e = 0; e < EARLY; e++)
        for (int r = 0; r < N && w->counts[e]; r++) {
            double left = -value[at_node[e]][r];
            for (int c = 0; c < M; c++) left += w->W[e][r * M + c] * plan->tau[e * M + c];
            plan->residual = larger(plan->residual, fabs(left) / g->row_scale[r]);
        }
    int p = 0, kept = 0;
    for (int i = 0; i <= COUNT; i++) {
        for (; p < count && (i == COUNT || t[p] <= w->node[i]); p++) {
            if (!fine[p]) continue;
            plan->effort_time[kept] = t[p];
            memcpy(plan->effort + M * kept++, own[p], sizeof own[p]);
        }
        if (i == COUNT || !w->counts[i] || (i < EARLY && fine[at_node[i]])) continue;
        plan->effort_time[kept] = w->node[i];
        memcpy(plan->effort + M * kept++, plan->tau + i * M, M * sizeof(double));
    }
    if (!kept) {
        plan->effort_time[0] = w->node[0];
        memcpy(plan->effort + M * kept++, plan->tau, M * sizeof(double));
    }
    if (kept == 1) {
        plan->effort_time[1] = plan->effort_time[0] + g->step;
        memcpy(plan->effort + M * kept++, plan->effort, M * sizeof(double));
    }
    for (int i = 0; i < kept; i++)
        for (int c = 0; c < M; c++) plan->effort[i * M + c] = larger(smaller(plan->effort[i * M + c], g->effort[c]), -g->effort[c]);
    plan->efforts = kept;
    if (count == 1) {
        plan->force_time[1] = t[0] + g->step, plan->forces = 2;
        memcpy(plan->force + K, plan->force, K * sizeof(double));
    }
}

/* One programme about ``w->at``, and what is made of it (``_command``). */
static int planned(const Given *g, Work *w, const double *t, int count, Plan *plan, long *iterations) {
    const double *ua = g->unit + 2 * K;
    for (int d = 0; d < 3; d++)
        for (int j = 0; j < K; j++) w->x[d][j] = w->given[d][j] / g->unit[d * K + j];
    linearise(g, w);
    if (w->borders > BORDER - 2 || !condense(g, w) || !set_programme(g, w)) return 0;
    int done = interior_point(g, w);
    if (!done) return 0;
    *iterations += done;
    double *s = plan->at, *sd = s + LANES, *sdd = sd + LANES;
    for (int j = 0; j < K; j++) s[j] = w->given[0][j], sd[j] = w->given[1][j];
    for (int l = 0; l < LANES; l++) sdd[l] = w->x[2][l] * ua[l % K];
    for (int l = K; l < LANES; l++) {   /* integrated once more */
        double h = w->h[l / K - 1];
        s[l] = s[l - K] + h * sd[l - K] + h * h / 6.0 * (2.0 * sdd[l - K] + sdd[l]);
        sd[l] = sd[l - K] + 0.5 * h * (sdd[l - K] + sdd[l]);
    }
    for (int l = 0; l < EFFORTS; l++) plan->tau[l] = w->tau[l] * w->tau_unit;
    set_multipliers(g, w, plan->multiplier);
    set_pieces(g, w, plan);
    set_efforts(g, w, t, count, plan);
    plan->left = 0.0;
    for (int i = 0; i < COUNT; i++) {
        double value[N + K];
        if (!w->counts[i]) continue;
        value_at(g, w->place[i], s + i * K, sd + i * K, sdd + i * K, value);
        for (int r = 0; r < N; r++) {
            double missed = -value[r];
            for (int c = 0; c < M; c++) missed += w->W[i][r * M + c] * plan->tau[i * M + c];
            plan->left = larger(plan->left, fabs(missed) / g->row[r]);
        }
    }
    return 1;
}

/* Polynomials (2, pieces, c) through values (pieces + 1, c). */
static void linear(const double *t, const double *value, long pieces, int c, double *edge, double *piece) {
    memcpy(edge, t, (pieces + 1) * sizeof *t);
    for (long i = 0; i < pieces; i++)
        for (int j = 0; j < c; j++) {
            piece[i * c + j] = (value[(i + 1) * c + j] - value[i * c + j]) / (t[i + 1] - t[i]);
            piece[(pieces + i) * c + j] = value[i * c + j];
        }
}

EXPORTED long rp_tick_work(void) { return sizeof(Work) + 2 * sizeof(Plan); }

EXPORTED long rp_tick_result(void) { return sizeof(Result); }

/* Plans from ``now`` on: what ``RecedingHorizon`` gives, as far as it is ``DONE``. */
EXPORTED int rp_tick(const Given *g, Result *result, void *memory) {
    Work *w = memory;
    Plan *best = (Plan *)(w + 1), *other = best + 1;
    double t[INSTANTS], coming = INFINITY, now = g->now;
    for (long r = 0; r < g->roots; r++)
        if (g->root[r] > now - SAME) coming = smaller(coming, g->root[r]);
    w->start = coming <= now + NEAR_ROOT * g->step ? coming : now;
    set_nodes(g, w);
    if (w->singulars > MOST_SINGULAR) return TOO_MANY;
    int count = set_instants(g, w, t);
    if (count < 0) return TOO_MANY;
    look_up(g, w, result, t, count);
    if (result->missing) return MISSING;
    memcpy(result->node, w->node, sizeof w->node);
    int known = 1;
    result->known = COUNT;
    for (int i = 0; i < COUNT; i++) {
        known = known && g->reachable[w->place[i]];
        w->known[i] = known && w->node[i] <= g->until + SAME;
        if (!w->known[i] && result->known == COUNT) result->known = i;
        if (!w->known[i] && w->node[i] <= g->until + SAME) return REFUSED;
        w->counts[i] = w->known[i] && (i || w->is_singular[0]);
    }
    double s[K], sd[K], sdd[K];
    extended(g->edge, g->piece, g->edges - 1, w->node[0], s, sd, sdd);
    int settled = coming <= now + SETTLED * g->step;
    for (int j = 0; j < K; j++) {
        w->given[0][j] = isnan(g->s[j]) || settled ? s[j] : g->s[j];
        w->given[1][j] = isnan(g->sd[j]) || settled ? sd[j] : g->sd[j];
        w->given[2][j] = sdd[j];
        double place = w->given[0][j];
        if (place < g->track[2 * j] - BEYOND || place > g->track[2 * j + 1] + BEYOND) return ELASTIC;
        if (fabs(w->given[1][j]) > g->speed[j] + BEYOND) return ELASTIC;
    }
    double share = smaller(larger(g->peak / g->tau, SMALLEST), 1.0), row = 0.0;
    w->tau_unit = share * g->tau;
    for (int i = 0; i < N; i++) row = larger(row, g->row[i]);
    /* about the last plan */
    int same = g->same_time && g->nodes == COUNT;
    for (int i = 0; i < COUNT && same; i++) same = g->node[i] == w->node[i];
    for (int i = 0; i < COUNT; i++) {
        extended(g->edge, g->piece, g->edges - 1, w->node[i], w->at[0] + i * K, w->at[1] + i * K, w->at[2] + i * K);
        for (int r = 0; r < N; r++) w->multiplier[i * N + r] = 0.0;
        for (long o = 0; o < g->nodes; o++)
            if (fabs(g->node[o] - w->node[i]) <= SAME) memcpy(w->multiplier + i * N, g->multiplier + o * N, N * sizeof(double));
    }
    if (same) memcpy(w->at, g->at, sizeof w->at);
    result->rounds = 1, result->iterations = 0;
    if (!planned(g, w, t, count, best, &result->iterations)) return UNSOLVED;
    int halfway = 0;
    for (int done = 1; done < MOST_ROUNDS; done++) {
        int near = 0;
        for (long r = 0; r < g->roots; r++) near |= g->root[r] > now && g->root[r] < now + CONVERGED * g->step;
        if (best->left <= LINEAR && (best->residual <= EXACT * row || !near)) break;
        if (!halfway) memcpy(w->at, best->at, sizeof w->at), memcpy(w->multiplier, best->multiplier, sizeof w->multiplier);
        result->rounds++;
        if (!planned(g, w, t, count, other, &result->iterations)) return UNSOLVED;
        halfway = other->left > larger(best->left, LINEAR);
        if (halfway) {   /* too far: f is linear nearer to the best so far */
            for (int d = 0; d < 3; d++)
                for (int l = 0; l < LANES; l++) w->at[d][l] = 0.5 * (best->at[d * LANES + l] + other->at[d * LANES + l]);
            for (int l = 0; l < COUNT * N; l++) w->multiplier[l] = 0.5 * (best->multiplier[l] + other->multiplier[l]);
        } else {
            Plan *swap = best;
            best = other, other = swap;
        }
    }
    if (best->left > STUCK) return ELASTIC;
    result->pieces = best->pieces;
    result->residual = best->residual, result->peak = best->peak, result->left = best->left;
    memcpy(result->at, best->at, sizeof best->at);
    memcpy(result->multiplier, best->multiplier, sizeof best->multiplier);
    memcpy(result->edge, best->edge, sizeof best->edge);
    memcpy(result->piece, best->piece, sizeof best->piece);
    linear(best->effort_time, best->effort, result->efforts = best->efforts - 1, M, result->effort_edge, result->effort);
    linear(best->force_time, best->force, result->forces = best->forces - 1, K, result->force_edge, result->force);
    /* the largest effort until the next tick */
    result->largest = 0.0;
    for (int i = 0; i < 5; i++) {
        double time = now + 0.25 * i * g->step;
        long e = 0;
        while (e < best->efforts - 2 && best->effort_time[e + 1] <= time) e++;
        double fraction = (time - best->effort_time[e]) / (best->effort_time[e + 1] - best->effort_time[e]);
        fraction = smaller(larger(fraction, 0.0), 1.0);
        for (int c = 0; c < M; c++) {
            double x = best->effort[e * M + c], y = best->effort[(e + 1) * M + c];
            result->largest = larger(result->largest, fabs(x + fraction * (y - x)));
        }
    }
    return DONE;
}

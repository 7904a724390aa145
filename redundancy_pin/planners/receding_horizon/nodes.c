/* What an update is given and what it works with; its nodes and instants, and f at them. */

/* Directions that are free at a node: in a relaxed programme all NF, else NZ, those that W tau = f leaves. */
enum { NX = 3 * K, NF = K + M, NW = NX + M, NZ = NF > N ? NF - N : 0, LANES = COUNT * K, EFFORTS = COUNT * M };
enum { NV = NX + NF, WIDE = (NV + LONG - 1) / LONG, TALL = (NW + LONG - 1) / LONG };   /* vectors for NV and NW numbers */
enum { BORDER = 2 * MOST_SINGULAR + 2, SIDES = BORDER + 1, BREAKS = INSTANTS / 4 };
enum { TIMES = INSTANTS + COUNT };                  /* of efforts: at instants, and then at nodes */
enum { OK = 0, UNSOLVED = 1, RELAXED = 2, REFUSED = 3, FALLBACK = 4, TIME_SCALED = 5, STOPPED = 6 };   /* STOPPED: by who evaluates */

/* Weights of the objective, in the order of ``Weights``. */
enum { EFFORT, PEAK, MEMORY, ACCELERATED, JERKED, CENTRE, END, END_SPEED, UNMET };

/* Bounds from above: of rows of one carrier at one node, and of their opposites, in blocks; what few programmes have
   stands at the end. */
enum { ACCELERATION, TRACK, SPEED, FORCE, BLOCKS };
enum { PEAK_AT = 2 * FORCE * LANES, STOP_AT = PEAK_AT + 2 * EFFORTS, LEAST_AT = STOP_AT + 4 * K };
enum { FORCE_AT = (LEAST_AT + LONG) / LONG * LONG, JERK_AT = FORCE_AT + 2 * LANES, EFFORT_AT = JERK_AT + 2 * LANES };
enum { BOUNDS = (EFFORT_AT + 2 * EFFORTS + LONG - 1) / LONG * LONG };

INLINE int block_at(int block) { return block < FORCE ? 2 * block * LANES : FORCE_AT; }

/* Of a programme, where the next one begins: duals of its bounds, and efforts at its nodes. */
typedef struct { double dual[BOUNDS], tau[EFFORTS]; } Solution;

typedef struct {
    long edges, roots, breaks, sharps, same_time;
    long first, strict, guesses;                    /* no last plan; no relaxed one is wanted; which motion to try next */
    const Window *window;                           /* the instants in sight */
    const double *edge, *piece;                     /* carriers of the last plan: (edges), (4, edges - 1, K) */
    const double *node, *at, *multiplier;           /* its nodes (COUNT), (3, COUNT, K) and (COUNT, N) there */
    const Solution *solution;
    const double *root, *broken, *sharp;                 /* singular instants, jumps of the platform's acceleration */
    const double *row_scale, *row, *track, *speed, *acceleration, *jerk, *carrier_force, *effort, *unit, *weight;
    const double *s, *sd;                           /* where the carriers are; NaN where the last plan is to be believed */
    double now, until, step, horizon, tau, largest, peak;
} Given;

/* What an update brings, and the next one begins with. The beginning of a function may be that of the plan before. */
enum { CARRIER_PIECES = 2 * (COUNT + K), EFFORT_PIECES = 2 * TIMES, FORCE_PIECES = 2 * INSTANTS };

typedef struct {
    long status, reason, pieces, efforts, forces, known, iterations, rounds, relaxed, guessed, singulars, changes;
    double t, residual, peak, left, largest, known_until, blocked, tau, so_far, row[N];
    Solution solution;
    double node[COUNT], at[3 * LANES], multiplier[COUNT * N], singular[MOST_ROOTS];
    double edge[CARRIER_PIECES + 1], piece[4 * CARRIER_PIECES * K];           /* carriers, as (4, pieces, K) */
    double effort_edge[EFFORT_PIECES + 1], effort[2 * EFFORT_PIECES * M];     /* efforts, as (2, efforts, M) */
    double force_edge[FORCE_PIECES + 1], force[2 * FORCE_PIECES * K];
} Result;

typedef struct { int node, other; double row[NW], beside[K], value; } Row;   /* of a singular instant */

typedef struct {
    /* nodes */
    double node[COUNT], h[COUNT];
    int known[COUNT], counts[COUNT], singular[COUNT], is_singular[COUNT], singulars, place[COUNT], beside[2 * COUNT];
    int early;   /* nodes in the first steps, in which efforts are exact */
    double start, given[3][K], tau_unit, row_unit[N];
    int free;      /* whether sdd at the start is, in a first plan */
    int beyond;    /* whether the start is beyond limits, which no plan keeps then */
    int relaxed;   /* whether W tau = f may be missed, at a cost of the square */
    /* linear about a plan, in units */
    double at[3][LANES], multiplier[COUNT * N];
    double W[COUNT][N * M], f[COUNT][N], by[COUNT][3][N * K], force[COUNT][K], by_force[COUNT][3][K];
    Row rows[BORDER];
    int borders;
    /* free[i] = M sigma + N z + c of node i, sigma of the one before: rows of sdd, then of tau */
    double motion[COUNT][NF][NV], constant[COUNT][NF], by_free[COUNT][NW][LONG * WIDE], by_free_turned[COUNT][NV][LONG * TALL];
    double orthonormal[COUNT][N][NF], triangle[COUNT][N][N];
    int directions[COUNT];
    double soft[COUNT][N][NW], soft_right[COUNT][N];   /* W tau = f of a relaxed programme, by motion and efforts of a node */
    double alpha[COUNT][K], gamma[COUNT][K], delta[COUNT][K];
    /* cost and bounds */
    double cost[3][3][LANES], linear[3][LANES], tau_cost[COUNT], cross[LANES], peak_cost;
    double a[3][BLOCKS][LANES], after[K];
    int bounds, blocks;
    double bound[BOUNDS], active[BOUNDS];
    /* interior point method */
    long iterations, rounds;
    int before;   /* whether there is a solution to begin with, of the last plan or the round before */
    double node_before[COUNT];
    Solution solution;
    double x[3][LANES], tau[EFFORTS], peak, nu[BORDER], row_missing[BORDER];
    double slack[BOUNDS], dual[BOUNDS], g[BOUNDS], weight[BOUNDS], missing[BOUNDS], change[BOUNDS], push[BOUNDS];
    double inverse_slack[BOUNDS], dslack[BOUNDS], ddual[BOUNDS], centre[BOUNDS], dx[3][LANES], dtau[EFFORTS], base[COUNT][NW];
    double H[3][3][LANES], tau_H[EFFORTS], crossing[LANES], peak_tau[EFFORTS];
    double feed[COUNT][SIDES][NF], lower[COUNT][NF][NF], across[COUNT][NF][LONG * WIDE], inverse[COUNT][NF];
    double border[SIDES * SIDES], gradient[SIDES][COUNT][NW], direction[SIDES][COUNT][NW];
} Work;

typedef struct {
    double at[3 * LANES], tau[EFFORTS], multiplier[COUNT * N], left;
    double residual, peak;
    long pieces, efforts, forces;
    int relaxed;
    double edge[COUNT + K + 1], piece[4 * (COUNT + K) * K];
    double effort_time[TIMES], effort[TIMES * M], force_time[INSTANTS], force[INSTANTS * K];
} Plan;

/* Numbers at least as large as others. */
INLINE void raise_to(Vector *numbers, const Vector *others) {
#if defined(__GNUC__) && !defined(ROBOT_SCALAR)
    Mask first = (Mask)(*numbers > *others);
    *numbers = (Vector)((first & (Mask)*numbers) | (~first & (Mask)*others));
#else
    *numbers = larger(*numbers, *others);
#endif
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
    const double own[6] = {s, s * s, v, s * v, a, v * v};
    const double slope[6][3] = {{1, 0, 0}, {2 * s, 0, 0}, {0, 1, 0}, {v, s, 0}, {0, 0, 1}, {0, 2 * v, 0}};
    const double bend[6][4] = {{0}, {2, 0, 0, 0}, {0}, {0, 1, 0, 0}, {0}, {0, 0, 0, 2}};
    int count = TERMS < 6 ? TERMS : 6;
    memcpy(value, own, (size_t)count * sizeof *own);
    memcpy(first, slope, (size_t)count * sizeof *slope);
    memcpy(second, bend, (size_t)count * sizeof *bend);
#if TERMS > 6
    for (int i = 1; i < 3; i++) {
        double c = cos(i * s), b = sin(i * s);
        const double wave[2][3] = {{c - 1.0, -i * b, -i * i * c}, {b, i * c, -i * i * b}};
        for (int which = 0; which < 2; which++) {
            const double *w = wave[which];
            int j = 6 + 2 * (i - 1) + which;
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
    memcpy(value, g->window->constant[place], (N + K) * sizeof *value);
    for (int j = 0; j < K; j++) {
        double phi[TERMS], first[TERMS][3], second[TERMS][4];
        const double *by_term = g->window->terms[place] + j * TERMS * (N + K);
        terms_of(s[j], sd[j], sdd[j], phi, first, second);
        for (int term = 0; term < TERMS; term++)
            for (int i = 0; i < N + K; i++) value[i] += phi[term] * by_term[term * (N + K) + i];
    }
}

/* Value, slopes (3, N + K, K) and, along y, second derivatives (K, 4). */
static void slopes_at(const Given *g, int place, const double *s, const double *sd, const double *sdd, const double *y,
                      double *value, double (*slope)[(N + K) * K], double (*bend)[4]) {
    memcpy(value, g->window->constant[place], (N + K) * sizeof *value);
    memset(slope, 0, 3 * sizeof *slope);
    if (bend) memset(bend, 0, K * sizeof *bend);
    for (int j = 0; j < K; j++) {
        double phi[TERMS], first[TERMS][3], second[TERMS][4];
        const double *by_term = g->window->terms[place] + j * TERMS * (N + K);
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

/* The nodes of a plan. */
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
    long sharp = 0;
    while (sharp < g->sharps && g->sharp[sharp] <= start - 2.0 * SHARP_ZONE * step) sharp++;
    int count = 0, next = 0;
    for (long long half = first; count < COUNT; half++) {
        double grid = 0.5 * step * (double)half, apart = INFINITY, nearest = INFINITY;
        while (next < many && chosen[next] <= grid && count < COUNT) w->node[count++] = chosen[next++];
        if (count >= COUNT) break;
        for (long r = 0; r < g->roots; r++) apart = smaller(apart, fabs(grid - g->root[r]));
        for (int c = begins; c < many; c++) nearest = smaller(nearest, fabs(grid - chosen[c]));
        double far = grid > start + (NEAR + 1e-6) * step ? 2.0 : 1.0;
        int fine = apart < far * ZONE * step;
        for (long r = sharp; r < g->sharps && r < sharp + MOST_SHARP; r++)
            fine |= fabs(grid - g->sharp[r]) < far * SHARP_ZONE * step;
        int unit = (int)far * (fine ? 1 : 2);
        if (half % unit == 0 && nearest > APART_OTHER * step && grid > start + SOON * step) w->node[count++] = grid;
    }
    w->early = 1;
    while (w->early < COUNT && w->node[w->early] <= start + (FIRST + SOON) * step + SAME) w->early++;
    w->singulars = 0;
    for (int i = 0; i < COUNT; i++) {
        w->is_singular[i] = 0;
        for (long r = 0; r < g->roots; r++) w->is_singular[i] |= w->node[i] == g->root[r];
        if (w->is_singular[i] && w->singulars < MOST_SINGULAR) w->singular[w->singulars++] = i;
        w->h[i] = i + 1 < COUNT ? w->node[i + 1] - w->node[i] : 0.0;
    }
}

/* The nodes, the instants of the grid and both sides of jumps of the acceleration from the first node to a last time; of very many
   jumps beside the first. Returns their number. */
static int instants_between(const Given *g, const double *node, int nodes, double last, double *t) {
    double first = node[0], broken[BREAKS], spacing = g->step / PARTS;
    int breaks = 0, count = 0, kept = 0;
    for (long b = 0; b < g->breaks && breaks < BREAKS; b++)
        if (g->broken[b] > first + 2.0 * BESIDE && g->broken[b] < last - 2.0 * BESIDE) broken[breaks++] = g->broken[b];
    for (int i = 0; i < nodes; i++) t[count++] = node[i];
    for (int b = 0; b < breaks; b++) t[count++] = broken[b] - BESIDE, t[count++] = broken[b] + BESIDE;
    for (double i = ceil(first / spacing); i < ceil(last / spacing); i++) {
        double grid = spacing * i, nearest = INFINITY;
        for (int j = 0; j < nodes; j++) nearest = smaller(nearest, fabs(grid - node[j]));
        for (int b = 0; b < breaks; b++) nearest = smaller(nearest, fabs(grid - broken[b]));
        if (nearest > 0.1 * spacing && count < INSTANTS - 1) t[count++] = grid;
    }
    for (int i = 1; i < count; i++) {   /* few, and all but the nodes in order */
        double x = t[i];
        int j = i;
        for (; j > 0 && t[j - 1] > x; j--) t[j] = t[j - 1];
        t[j] = x;
    }
    for (int i = 0; i < count; i++)
        if (!i || t[i] != t[kept - 1]) t[kept++] = t[i];
    return kept;
}

/* The instants at which the efforts of a plan are evaluated; their number. */
static int set_instants(const Given *g, const Work *w, double *t) {
    int nodes = 0;
    while (nodes < w->early && w->node[nodes] <= g->until + SAME) nodes++;
    if (!nodes) nodes = 1;
    return instants_between(g, w->node, nodes, w->node[nodes - 1], t);
}

/* Where all instants are that an update needs; 0 where the update is to end. */
static int look_up(const Sight *v, const Given *g, Work *w, const double *instants, int count) {
    double time[COUNT + 2 * MOST_SINGULAR + INSTANTS];
    int many = 0;
    for (int i = 0; i < COUNT; i++) time[many++] = smaller(w->node[i], g->until);
    for (int r = 0; r < w->singulars; r++)
        for (int side = -1; side < 2; side += 2) time[many++] = smaller(w->node[w->singular[r]] + side * DIFFERENCE, g->until);
    for (int i = 0; i < count; i++) time[many++] = smaller(instants[i], g->until);
    if (!ensure(v, time, many)) return 0;
    for (int i = 0; i < COUNT; i++) w->place[i] = found(g->window, time[i]);
    for (int i = 0; i < 2 * w->singulars; i++) w->beside[i] = found(g->window, time[COUNT + i]);
    return 1;
}

static const double *W_at(const Given *g, int place) { return g->window->W[place]; }

/* The direction u that W loses, the square of its largest singular value, if wanted, and that of the smallest over it. */
static double spectrum(const Given *g, const double *W, double *u, double *largest) {
    double A[N * N], V[N * N];
    int least = 0, most = 0;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            A[i * N + j] = 0.0;
            for (int c = 0; c < M; c++) A[i * N + j] += W[i * M + c] / g->row_scale[i] * W[j * M + c] / g->row_scale[j];
        }
    eigen(N, A, V);
    for (int i = 1; i < N; i++) {
        if (A[i * (N + 1)] < A[least * (N + 1)]) least = i;
        if (A[i * (N + 1)] > A[most * (N + 1)]) most = i;
    }
    for (int i = 0; i < N; i++) u[i] = V[i * N + least] / g->row_scale[i];
    if (largest) *largest = A[most * (N + 1)];
    return A[least * (N + 1)] / A[most * (N + 1)];
}

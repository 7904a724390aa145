/* The solver: an interior point method, a Riccati recursion in each of its steps. */

/* G applied to a motion, efforts and the peak. */
static void apply(const Work *w, double (*x)[LANES], const double *tau, double peak, double *g) {
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

/* What the point so far misses of a row of W tau = f in a relaxed programme. */
static double missed_softly(const Work *w, int i, int r) {
    double x = -w->soft_right[i][r];
    for (int d = 0; d < 3; d++)
        for (int j = 0; j < K; j++) x += w->soft[i][r][d * K + j] * w->x[d][i * K + j];
    for (int c = 0; c < M; c++) x += w->soft[i][r][NX + c] * w->tau[i * M + c];
    return x;
}

/* Gradient of the cost at the point so far, with the multipliers of the border; return its part for the peak. */
static double set_gradient(const Given *g, const Work *w, double (*gradient)[NW]) {
    for (int i = 0; i < COUNT; i++) {
        for (int j = 0; j < K; j++) {
            int l = i * K + j;
            for (int p = 0; p < 3; p++) {
                double y = w->linear[p][l];
                for (int q = 0; q < 3; q++) y += w->cost[p][q][l] * w->x[q][l];
                gradient[i][p * K + j] = y;
            }
            if (i + 1 < COUNT) gradient[i][2 * K + j] += w->cross[l] * w->x[2][l + K];
            if (i) gradient[i][2 * K + j] += w->cross[l - K] * w->x[2][l - K];
        }
        for (int c = 0; c < M; c++) gradient[i][NX + c] = w->tau_cost[i] * w->tau[i * M + c];
    }
    for (int i = 0; i < COUNT && w->relaxed; i++)
        for (int r = 0; r < N && w->counts[i]; r++) {
            double by = g->weight[UNMET] * missed_softly(w, i, r);
            for (int e = 0; e < NW; e++) gradient[i][e] += by * w->soft[i][r][e];
        }
    for (int b = 0; b < w->borders; b++) {
        const Row *row = &w->rows[b];
        for (int e = 0; e < NW; e++) gradient[row->node][e] += w->nu[b] * row->row[e];
        for (int j = 0; j < K; j++) gradient[row->other][2 * K + j] += w->nu[b] * row->beside[j];
    }
    return w->peak_cost * w->peak;
}

/* Vectors for the motion before a node and so many free directions of it. */
INLINE int vectors(int free) { return (NX + free + LONG - 1) / LONG; }

/* a += x b, of vectors. */
INLINE void add(int count, Vector *a, double x, const double *b) {
    for (int v = 0; v < count; v++) a[v] += x * ((const Vector *)b)[v];
}

/* The Riccati recursion; 0 where a step of it is not positive. ``most``: free directions of a node, which the compiler is to
   know, as it has to everywhere in the recursions. */
INLINE int factorise_of(const Given *g, Work *w, int most) {
    const int wide = vectors(most);
    double P[NX][LONG * WIDE], H_by[NW][LONG * WIDE], Q[NV][LONG * WIDE];
    memset(P, 0, sizeof P);
    for (int i = COUNT - 1; i >= 0; i--) {
        double(*by)[LONG * WIDE] = w->by_free[i];
        for (int d = 0; d < 3; d++)
            for (int e = 0; e < 3; e++)
                for (int j = 0; j < K; j++) P[d * K + j][e * K + j] += w->H[d][e][i * K + j];
        int from = i || w->free ? 0 : NX;
        for (int r = from; r < NX; r++) {
            Vector row[WIDE] = NO_VECTORS;
            for (int k = 0; k < NX; k++) add(wide, row, P[r][k], by[k]);
            memcpy(H_by[r], row, (size_t)wide * sizeof *row);
        }
        for (int t = 0; t < M; t++) {
            Vector row[WIDE] = NO_VECTORS;
            add(wide, row, w->tau_H[i * M + t], by[NX + t]);
            memcpy(H_by[NX + t], row, (size_t)wide * sizeof *row);
        }
        for (int r = 0; r < NX + most; r++) {
            Vector row[WIDE] = NO_VECTORS;
            for (int e = from; e < NW; e++) add(wide, row, by[e][r], H_by[e]);
            memcpy(Q[r], row, (size_t)wide * sizeof *row);
        }
        for (int r = 0; r < N && w->relaxed && w->counts[i]; r++) {
            double along[LONG * WIDE];
            Vector row[WIDE] = NO_VECTORS;
            for (int e = from; e < NW; e++) add(wide, row, w->soft[i][r][e], by[e]);
            memcpy(along, row, (size_t)wide * sizeof *row);
            for (int e = 0; e < NX + most; e++) add(wide, (Vector *)Q[e], g->weight[UNMET] * along[e], along);
        }
        for (int j = 0; j < K && i; j++) {   /* sdd with that before it */
            double x = w->crossing[(i - 1) * K + j];
            int before = 2 * K + j;
            for (int c = 0; c < NX + most; c++) Q[before][c] += x * by[before][c];
            for (int c = 0; c < NX + most; c++) Q[c][before] += x * by[before][c];
        }
        /* Qzz = L D L', U = 1/L Qzs */
        double(*L)[NF] = w->lower[i], (*U)[LONG * WIDE] = w->across[i], *inverse = w->inverse[i], D[NF];
        for (int p = 0; p < most; p++) {
            int free = p < w->directions[i];
            Vector row[WIDE] = NO_VECTORS;
            D[p] = free ? Q[NX + p][NX + p] : 1.0;
            if (free) memcpy(row, Q[NX + p], (size_t)wide * sizeof *row);
            for (int o = 0; o < p; o++) {
                double x = free ? Q[NX + p][NX + o] : 0.0;
                for (int l = 0; l < o; l++) x -= L[p][l] * D[l] * L[o][l];
                L[p][o] = x * inverse[o];
                D[p] -= L[p][o] * x;
                add(wide, row, -L[p][o], U[o]);
            }
            memcpy(U[p], row, (size_t)wide * sizeof *row);
            if (!(D[p] > 0.0)) return 0;
            inverse[p] = 1.0 / D[p];
        }
        for (int r = 0; r < NX; r++) {
            Vector row[WIDE];
            memcpy(row, Q[r], (size_t)wide * sizeof *row);
            for (int p = 0; p < most; p++) add(wide, row, -U[p][r] * inverse[p], U[p]);
            memcpy(P[r], row, (size_t)wide * sizeof *row);
        }
    }
    return 1;
}

static int factorise(const Given *g, Work *w) { return w->relaxed ? factorise_of(g, w, NF) : factorise_of(g, w, NZ); }

/* A gradient by nodes (`own`, and what the nodes after it add) by what is free at one: [sigma, z]. */
INLINE void gather(const Work *w, int i, int wide, const double *own, const double *carried, Vector *q) {
    const double(*by)[LONG * WIDE] = w->by_free[i];
    for (int v = 0; v < wide; v++) q[v] = NO_VECTOR;
    for (int r = i || w->free ? 0 : NX; r < NX; r++) add(wide, q, own[r] + carried[r], by[r]);
    for (int r = NX; r < NW; r++) add(wide, q, own[r], by[r]);
}

/* Steps against gradients, of ``sides`` right sides. */
INLINE void step_against_of(Work *w, int sides, int most) {
    const int wide = vectors(most);
    double carried[SIDES][LONG * WIDE], z[SIDES][NV];
    memset(carried, 0, (size_t)sides * sizeof *carried);
    for (int i = COUNT - 1; i >= 0; i--)
        for (int s = 0; s < sides; s++) {
            Vector q[WIDE];
            double *k = w->feed[i][s], own[LONG * WIDE];
            double(*L)[NF] = w->lower[i], (*U)[LONG * WIDE] = w->across[i];
            gather(w, i, wide, w->gradient[s][i], carried[s], q);
            memcpy(own, q, (size_t)wide * sizeof *q);
            for (int p = 0; p < most; p++) {   /* 1/L q */
                double x = p < w->directions[i] ? own[NX + p] : 0.0;
                for (int o = 0; o < p; o++) x -= L[p][o] * k[o];
                k[p] = x;
                add(wide, q, -x * w->inverse[i][p], U[p]);
            }
            memcpy(carried[s], q, (size_t)wide * sizeof *q);
        }
    memset(z, 0, (size_t)sides * sizeof *z);
    for (int i = 0; i < COUNT; i++)
        for (int s = 0; s < sides; s++) {
            double(*L)[NF] = w->lower[i], (*U)[LONG * WIDE] = w->across[i];
            double *own = z[s];
            Vector out[TALL] = NO_VECTORS;
            for (int p = most - 1; p >= 0; p--) {   /* -1/L' 1/D (k + U sigma) */
                double x = w->feed[i][s][p];
                for (int c = 0; c < NX; c++) x += U[p][c] * own[c];
                x *= -w->inverse[i][p];
                for (int o = p + 1; o < most; o++) x -= L[o][p] * own[NX + o];
                own[NX + p] = p < w->directions[i] ? x : 0.0;
            }
            for (int c = 0; c < NX + most; c++) add(TALL, out, own[c], w->by_free_turned[i][c]);
            memcpy(w->direction[s][i], out, NW * sizeof(double));
            memcpy(own, out, NX * sizeof *own);
        }
}

static void step_against(Work *w, int sides) {
    if (w->relaxed) step_against_of(w, sides, NF);
    else step_against_of(w, sides, NZ);
}

static double along_row(const Row *row, double (*v)[NW]) {
    double x = 0.0;
    for (int e = 0; e < NW; e++) x += row->row[e] * v[row->node][e];
    for (int j = 0; j < K; j++) x += row->beside[j] * v[row->other][2 * K + j];
    return x;
}

/* Duals of the solution before at the nodes that both have, of bounds from ``place`` on, ``width`` a node and side. */
static void remember(Work *w, const int *old, int place, int width) {
    for (int side = 0; side < 2; side++, place += COUNT * width)
        for (int i = 0; i < COUNT; i++)
            for (int l = 0; l < width; l++)
                w->dual[place + i * width + l] = old[i] < 0 ? 0.0 : w->solution.dual[place + old[i] * width + l];
}

/* A first point: sdd as near as it may be to those of the plan that all is linear about, and efforts and duals to those of
   the solution before, if it is to be ``warm``. */
static void begin_iterations(const Given *g, Work *w, int warm) {
    const double *ua = g->unit + 2 * K;
    double room = warm ? WARM_SLACK : w->relaxed ? RELAXED_SLACK : LEAST_SLACK;
    double barrier = warm ? WARM_BARRIER : w->relaxed ? RELAXED_BARRIER : FIRST_BARRIER;
    int old[COUNT], size = w->relaxed ? NF : NZ;
    for (int i = 0, o = 0; i < COUNT; i++) {
        while (o < COUNT && w->node_before[o] < w->node[i] - SAME) o++;
        old[i] = warm && o < COUNT && w->node_before[o] <= w->node[i] + SAME ? o : -1;
    }
    for (int d = 0; d < 3; d++)
        for (int j = 0; j < K; j++) w->x[d][j] = w->given[d][j] / g->unit[d * K + j];
    for (int i = 0; i < COUNT; i++) {
        double z[NV], free[NF], A[NF * NF], rhs[NF];
        int given = !i && !w->free;
        memset(z, 0, sizeof z);
        if (i)
            for (int d = 0; d < 3; d++)
                for (int j = 0; j < K; j++) z[d * K + j] = w->x[d][(i - 1) * K + j];
        for (int e = 0; e < NF; e++) {
            free[e] = w->constant[i][e];
            for (int c = 0; c < NX; c++) free[e] += w->motion[i][e][c] * (i ? z[c] : w->x[c / K][c % K]);
        }
        for (int p = 0; p < size; p++) {
            rhs[p] = 0.0;
            for (int o = 0; o < size; o++) A[p * size + o] = p == o ? DAMPING : 0.0;
            if (p >= w->directions[i] || given) continue;
            for (int j = 0; j < K; j++) {
                double own = w->motion[i][j][NX + p];
                int limit = block_at(ACCELERATION) + i * K + j;
                double aim = w->at[2][i * K + j] / ua[j], most = WITHIN * w->bound[limit];
                if (w->active[limit] > 0.0) aim = larger(-most, smaller(aim, most));   /* past its end it was to stop */
                rhs[p] += own * (aim - free[j]);
                for (int o = 0; o < w->directions[i]; o++) A[p * size + o] += own * w->motion[i][j][NX + o];
            }
            if (old[i] >= 0 && !isnan(w->solution.tau[old[i] * M]))
                for (int c = 0; c < M; c++)
                    rhs[p] += DAMPING * w->motion[i][K + c][NX + p] * (w->solution.tau[old[i] * M + c] / w->tau_unit - free[K + c]);
        }
        solved(size, 1, A, rhs);
        for (int e = 0; e < NF; e++)
            for (int p = 0; p < w->directions[i]; p++) free[e] += w->motion[i][e][NX + p] * rhs[p];
        for (int c = 0; c < M; c++) w->tau[i * M + c] = w->counts[i] ? free[K + c] : 0.0;
        for (int j = 0; j < K && w->free && !i; j++) w->x[2][j] = free[j];
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
    w->peak += room;
    memset(w->nu, 0, sizeof w->nu);
    apply(w, w->x, w->tau, w->peak, w->g);
    if (warm) {
        memcpy(w->dual, w->solution.dual, sizeof w->dual);
        for (int b = 0; b < w->blocks; b++) remember(w, old, block_at(b), K);
        remember(w, old, PEAK_AT, M);
        if (w->blocks == BLOCKS) remember(w, old, JERK_AT, K), remember(w, old, EFFORT_AT, M);
    } else
        memset(w->dual, 0, sizeof w->dual);
    for (int c = 0; c < w->bounds; c++) {
        double slack = larger(w->bound[c] - w->g[c], room);
        w->slack[c] = w->active[c] > 0.0 ? slack : 1.0;
        w->dual[c] = w->active[c] > 0.0 ? larger(w->dual[c], barrier / slack) : 1.0;
    }
}

/* The derivative of the peak's gradient along a direction, by its efforts. */
static double along_peak(const Work *w, double (*v)[NW]) {
    double part[M] = {0}, sum = 0.0;
    for (int i = 0; i < COUNT; i++)
        for (int c = 0; c < M; c++) part[c] += w->peak_tau[i * M + c] * v[i][NX + c];
    for (int c = 0; c < M; c++) sum += part[c];
    return sum;
}

/* What the peak and the rows of singular instants do to each other: their parts of the steps against them. */
static void set_border(Work *w, double give, double peak_H) {
    int size = 1 + w->borders;
    for (int s = 0; s < size; s++) {
        double(*v)[NW] = w->direction[1 + s];
        w->border[s] = along_peak(w, v) + (s ? 0.0 : peak_H);
        for (int b = 0; b < w->borders; b++) w->border[(b + 1) * size + s] = along_row(&w->rows[b], v) - (b + 1 == s ? give : 0.0);
    }
}

/* The direction against gradient 0 and the missing rows; its change of every bound. */
static int direct(Work *w, double peak_gradient, double *dpeak, double *dnu) {
    int size = 1 + w->borders;
    double S[SIDES * SIDES], right[SIDES];
    double(*first)[NW] = w->direction[0];
    memcpy(S, w->border, (size_t)(size * size) * sizeof *S);
    right[0] = -peak_gradient - along_peak(w, first);
    for (int b = 0; b < w->borders; b++) right[b + 1] = w->row_missing[b] - along_row(&w->rows[b], first);
    if (!solved(size, 1, S, right)) return 0;
    *dpeak = right[0];
    memcpy(dnu, right + 1, (size_t)w->borders * sizeof *dnu);
    for (int i = 0; i < COUNT; i++) {
        double whole[NW];
        memcpy(whole, first[i], sizeof whole);
        for (int s = 0; s < size; s++)
            for (int e = 0; e < NW; e++) whole[e] += right[s] * w->direction[1 + s][i][e];
        for (int d = 0; d < 3; d++)
            for (int j = 0; j < K; j++) w->dx[d][i * K + j] = whole[d * K + j];
        for (int c = 0; c < M; c++) w->dtau[i * M + c] = whole[NX + c];
    }
    apply(w, w->dx, w->dtau, *dpeak, w->change);
    return 1;
}

/* Whether the gradient with the duals, brought back along the motion, is rounding; ``base`` has it without them. It is
   left in gradient 1. */
static int is_stationary(Work *w, double base_peak) {
    double carried[LONG * WIDE], own[LONG * WIDE], size = 1.0, left;
    Vector q[WIDE];
    for (int c = 0; c < w->bounds; c++) w->centre[c] = w->active[c] * w->dual[c];
    memcpy(w->gradient[1], w->base, sizeof w->base);
    left = fabs(base_peak + add_transposed(w, w->centre, w->gradient[1]));
    memset(carried, 0, sizeof carried);
    for (int i = COUNT - 1; i >= 0; i--) {
        for (int r = 0; r < NW; r++) size = larger(size, fabs(w->gradient[1][i][r] + (r < NX ? carried[r] : 0.0)));
        gather(w, i, WIDE, w->gradient[1][i], carried, q);
        memcpy(own, q, sizeof own);
        for (int z = 0; z < w->directions[i]; z++) left = larger(left, fabs(own[NX + z]));
        memcpy(carried, q, sizeof carried);
    }
    return left < STATIONARY * size;
}

#define OF(name) *name = (Vector *)w->name

static double sum_of(const Vector *v) {
    double sum = 0.0;
    for (int l = 0; l < LONG; l++) sum += PART_OF(*v, l);
    return sum;
}

static double most_of(const Vector *v) {
    double most = PART_OF(*v, 0);
    for (int l = 1; l < LONG; l++) most = larger(most, PART_OF(*v, l));
    return most;
}

/* Slacks, duals and what is missing, and how far from the centre they are: the mean of slacks times duals, and the most
   that is missing. */
static double weigh(Work *w, double count, double *most) {
    Vector OF(active), OF(slack), OF(dual), OF(g), OF(bound);
    Vector OF(missing), OF(weight), OF(push), OF(inverse_slack);
    Vector sum = NO_VECTOR, worst = NO_VECTOR;
    for (int v = 0; v < w->bounds / LONG; v++) {
        Vector lacks = active[v] * (g[v] - bound[v] + slack[v]), inverse = 1.0 / slack[v], own = active[v] * dual[v];
        inverse_slack[v] = inverse, missing[v] = lacks;
        weight[v] = own * inverse, push[v] = own * inverse * lacks;
        sum += own * slack[v];
        Vector other = -lacks;
        raise_to(&worst, &lacks), raise_to(&worst, &other);
    }
    *most = most_of(&worst);
    return sum_of(&sum) / count;
}

/* How far the direction without centring may be gone; ``after``: the mean of slacks times duals there. Its products of
   second order are left in ``centre``. */
static double predict(Work *w, double barrier, double count, double *after) {
    Vector OF(active), OF(dual), OF(missing), OF(weight), OF(change), OF(inverse_slack), OF(centre);
    Vector worst = NO_VECTOR + 1.0, second = NO_VECTOR;
    for (int v = 0; v < w->bounds / LONG; v++) {
        Vector dslack = -missing[v] - active[v] * change[v], ddual = -active[v] * dual[v] - weight[v] * dslack;
        Vector share = dslack * inverse_slack[v];   /* of the slack; of the dual it is -1 - that */
        Vector of_slack = -share, of_dual = 1.0 + share;
        raise_to(&worst, &of_slack), raise_to(&worst, &of_dual);
        centre[v] = dslack * ddual;
        second += centre[v];
    }
    double alpha = 1.0 / most_of(&worst);
    *after = larger((1.0 - alpha) * barrier + alpha * alpha * sum_of(&second) / count, 0.0);
    return alpha;
}

/* Centring that brings them to ``aim``, with the terms of second order of a step of ``alpha`` without it. */
static void set_centre(Work *w, double aim, double alpha) {
    Vector OF(active), OF(inverse_slack), OF(centre), OF(push);
    for (int v = 0; v < w->bounds / LONG; v++) {
        centre[v] = active[v] * (aim - alpha * centre[v]) * inverse_slack[v];
        push[v] += centre[v];
    }
}

/* The change of slacks and duals; how far it may be gone. */
static double correct(Work *w) {
    Vector OF(active), OF(dual), OF(missing), OF(weight), OF(change), OF(inverse_slack), OF(centre);
    Vector OF(dslack), OF(ddual);
    Vector worst = NO_VECTOR + 1.0;
    for (int v = 0; v < w->bounds / LONG; v++) {
        dslack[v] = -missing[v] - active[v] * change[v];
        ddual[v] = centre[v] - active[v] * dual[v] - weight[v] * dslack[v];
        Vector of_slack = -dslack[v] * inverse_slack[v], of_dual = -ddual[v] / dual[v];
        raise_to(&worst, &of_slack), raise_to(&worst, &of_dual);
    }
    return 1.0 / most_of(&worst);
}

/* Second derivatives of the cost with the bounds; return that by the peak. */
static double set_hessian(Work *w) {
    double peak_H = w->peak_cost + w->weight[LEAST_AT], part[M] = {0};
    memcpy(w->H, w->cost, sizeof w->H);
    memcpy(w->crossing, w->cross, sizeof w->crossing);
    for (int b = 0; b < w->blocks; b++) {
        const double *up = w->weight + block_at(b), *down = up + LANES;
        for (int p = 0; p < 3; p++)
            for (int q = 0; q < 3; q++) {
                if (b == ACCELERATION ? p < 2 || q < 2 : b == SPEED && (!p || !q)) continue;
                for (int l = 0; l < LANES; l++) w->H[p][q][l] += (up[l] + down[l]) * w->a[p][b][l] * w->a[q][b][l];
            }
    }
    for (int j = 0; j < K; j++) {
        const double *stop = w->weight + STOP_AT + j, out = stop[0] + stop[K], back = stop[2 * K] + stop[3 * K];
        double after = w->after[j];
        int l = LANES - K + j;
        w->H[0][0][l] += out + back, w->H[1][1][l] += after * after * (out + back);
        w->H[0][1][l] += after * (out - back), w->H[1][0][l] += after * (out - back);
    }
    int many = w->blocks == BLOCKS;
    for (int l = 0; l < LANES - K && many; l++) {
        double both = w->weight[JERK_AT + l] + w->weight[JERK_AT + LANES + l];
        w->H[2][2][l] += both, w->H[2][2][l + K] += both, w->crossing[l] -= both;
    }
    for (int i = 0; i < COUNT; i++)
        for (int c = 0; c < M; c++) {
            int l = i * M + c;
            double up = w->weight[PEAK_AT + l], down = w->weight[PEAK_AT + EFFORTS + l];
            w->tau_H[l] = w->tau_cost[i] + up + down;
            if (many) w->tau_H[l] += w->weight[EFFORT_AT + l] + w->weight[EFFORT_AT + EFFORTS + l];
            w->peak_tau[l] = down - up;
            part[c] += up + down;
        }
    for (int c = 0; c < M; c++) peak_H += part[c];
    return peak_H;
}

/* What the rows of singular instants miss; the most. */
static double set_row_missing(Work *w, double give) {
    double most = 0.0;
    for (int b = 0; b < w->borders; b++) {
        const Row *row = &w->rows[b];
        double x = row->value + give * w->nu[b];
        for (int j = 0; j < K; j++) {
            for (int d = 0; d < 3; d++) x -= row->row[d * K + j] * w->x[d][row->node * K + j];
            x -= row->beside[j] * w->x[2][row->other * K + j];
        }
        for (int c = 0; c < M; c++) x -= row->row[NX + c] * w->tau[row->node * M + c];
        w->row_missing[b] = x, most = larger(most, fabs(x));
    }
    return most;
}

/* The gradients of the peak and of the rows of singular instants: right sides beside the first one. */
static void set_sides(Work *w) {
    for (int s = 1; s < 2 + w->borders; s++) memset(w->gradient[s], 0, sizeof w->gradient[s]);
    for (int i = 0; i < COUNT; i++)
        for (int c = 0; c < M; c++) w->gradient[1][i][NX + c] = w->peak_tau[i * M + c];
    for (int b = 0; b < w->borders; b++) {
        const Row *row = &w->rows[b];
        memcpy(w->gradient[2 + b][row->node], row->row, sizeof row->row);
        for (int j = 0; j < K; j++) w->gradient[2 + b][row->other][2 * K + j] += row->beside[j];
    }
}

/* Keep where the next programme begins. */
static void keep_solution(Work *w) {
    memcpy(w->node_before, w->node, sizeof w->node);
    memset(w->solution.dual, 0, sizeof w->solution.dual);
    for (int c = 0; c < w->bounds; c++) w->solution.dual[c] = w->active[c] * w->dual[c];
    for (int l = 0; l < EFFORTS; l++) w->solution.tau[l] = w->counts[l / M] ? w->tau[l] * w->tau_unit : NAN;
    w->before = 1;
}

/* Go along a direction. */
static void go(Work *w, double alpha, double dpeak, const double *dnu) {
    for (int d = 0; d < 3; d++)
        for (int l = 0; l < LANES; l++) w->x[d][l] += alpha * w->dx[d][l];
    for (int l = 0; l < EFFORTS; l++) w->tau[l] += alpha * w->dtau[l];
    w->peak += alpha * dpeak;
    for (int b = 0; b < w->borders; b++) w->nu[b] += alpha * dnu[b];
    for (int c = 0; c < w->bounds; c++) w->slack[c] += alpha * w->dslack[c], w->dual[c] += alpha * w->ddual[c];
}

/* Mehrotra's predictor and corrector; whether an optimum is found. */
static int interior_point(const Given *g, Work *w, int warm) {
    begin_iterations(g, w, warm);
    double count = 0.0, most, after, dpeak, dnu[BORDER], give = w->relaxed ? 1.0 / g->weight[UNMET] : 0.0;
    for (int c = 0; c < w->bounds; c++) count += w->active[c];
    int last = w->relaxed ? RELAXED_ITERATIONS : ITERATIONS;
    for (int iteration = 0; iteration < last; iteration++, w->iterations++) {
        apply(w, w->x, w->tau, w->peak, w->g);
        double barrier = weigh(w, count, &most), rows = set_row_missing(w, give);
        if (!(barrier < DIVERGED)) return 0;
        double base_peak = set_gradient(g, w, w->gradient[0]);
        memcpy(w->base, w->gradient[0], sizeof w->base);
        if (barrier < BARRIER && most < PRECISION && rows < PRECISION && is_stationary(w, base_peak)) {
            keep_solution(w);
            return 1;
        }
        double peak_H = set_hessian(w);
        if (!factorise(g, w)) return 0;
        double peak_gradient = base_peak + add_transposed(w, w->push, w->gradient[0]);
        set_sides(w);
        step_against(w, 2 + w->borders);
        set_border(w, w->relaxed ? give : BORDER_GIVES, peak_H);
        if (!direct(w, peak_gradient, &dpeak, dnu)) return 0;
        double alpha = predict(w, barrier, count, &after);
        set_centre(w, larger(pow(after / barrier, 3.0) * barrier, CENTRED * BARRIER), alpha);
        memcpy(w->gradient[0], w->base, sizeof w->base);
        peak_gradient = base_peak + add_transposed(w, w->push, w->gradient[0]);
        step_against(w, 1);
        if (!direct(w, peak_gradient, &dpeak, dnu)) return 0;
        alpha = correct(w);
        alpha = alpha >= 1.0 ? 1.0 : alpha * CLOSE;
        if (!(alpha >= SHORTEST_WAY)) return 0;
        go(w, alpha, dpeak, dnu);
    }
    return 0;
}

/* The multipliers of W tau = f, from the gradient that ``is_stationary`` left; of a relaxed programme from what is missed. */
static void set_multipliers(const Given *g, Work *w, double *multiplier) {
    double(*gradient)[NW] = w->gradient[1];
    double carried[LONG * WIDE];
    memset(carried, 0, sizeof carried);
    memset(multiplier, 0, COUNT * N * sizeof *multiplier);
    if (w->relaxed) {
        for (int l = 0; l < COUNT * N; l++)
            if (w->counts[l / N]) multiplier[l] = g->weight[UNMET] * missed_softly(w, l / N, l % N) / w->row_unit[l % N];
        return;
    }
    for (int i = COUNT - 1; i >= !w->free; i--) {
        double x[NX], free[NF], A[N * N], y[N];
        Vector q[WIDE];
        for (int c = 0; c < NX; c++) x[c] = gradient[i][c] + carried[c];
        for (int j = 0; j < K; j++) free[j] = w->gamma[i][j] * x[j] + w->delta[i][j] * x[K + j] + x[2 * K + j];
        memcpy(free + K, gradient[i] + NX, M * sizeof *free);
        gather(w, i, WIDE, gradient[i], carried, q);
        memcpy(carried, q, sizeof carried);
        if (!w->counts[i]) continue;
        for (int o = 0; o < N; o++) {
            y[o] = 0.0;
            for (int e = 0; e < NF; e++) y[o] -= w->orthonormal[i][o][e] * free[e];
            for (int r = 0; r < N; r++) A[o * N + r] = w->triangle[i][r][o];
        }
        if (solved(N, 1, A, y))
            for (int r = 0; r < N; r++) multiplier[i * N + r] = y[r] / w->row_unit[r];
    }
}

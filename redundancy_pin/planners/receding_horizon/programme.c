/* The programme of a tick: linear about a plan, condensed to what W tau = f leaves free, its costs and bounds. */

/* W tau = f and the rows of singular instants, linear about ``w->at``. */
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
            double cost[3][3] = {{0}};
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
                for (int q = 0; q < 3; q++) {
                    w->cost[p][q][i * K + j] = cost[p][q];
                    w->linear[p][i * K + j] -= cost[p][q] * at[q][j] / u[q];
                }
            }
        }
    }
    w->borders = 0;
    for (int r = 0; r < w->singulars; r++) {
        int q = w->singular[r];
        if (!w->known[q]) continue;
        double u[N], rates[2][N + K], slopes[2][3][(N + K) * K], W_rate[M], f_rate = 0.0, by[4][K];
        spectrum(g, w->W[q], u, 0);
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
        size = ut * larger(size, SLOWEST * largest / g->horizon);
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
            if (side < 0 ? q == 0 : side == 0 ? q > 0 || w->free : q + 1 >= COUNT) continue;
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

/* The motion of each node and its efforts, [s, sd, sdd, tau], by the motion sigma before it and what is free, z:

       s' = s + alpha sd + 2 gamma sdd + gamma sdd',    sd' = sd + delta (sdd + sdd'). */
static void set_by_free(Work *w) {
    int most = NX + (w->relaxed ? NF : NZ);
    memset(w->by_free, 0, sizeof w->by_free);
    memset(w->by_free_turned, 0, sizeof w->by_free_turned);
    for (int i = 0; i < COUNT; i++) {
        double(*by)[LONG * WIDE] = w->by_free[i], (*free)[NV] = w->motion[i];
        for (int j = 0; j < K && (i || w->free); j++) {   /* else the motion of the start is given */
            double alpha = w->alpha[i][j], gamma = w->gamma[i][j], delta = w->delta[i][j];
            for (int c = 0; c < most; c++) by[j][c] = gamma * free[j][c], by[K + j][c] = delta * free[j][c], by[2 * K + j][c] = free[j][c];
            by[j][j] += 1.0, by[j][K + j] += alpha, by[j][2 * K + j] += 2.0 * gamma;
            by[K + j][K + j] += 1.0, by[K + j][2 * K + j] += delta;
        }
        for (int t = 0; t < M; t++)
            for (int c = i || w->free ? 0 : NX; c < most; c++) by[NX + t][c] = free[K + t][c];
        for (int r = 0; r < NW; r++)
            for (int c = 0; c < most; c++) w->by_free_turned[i][c][r] = by[r][c];
    }
}

/* What W tau = f leaves free at each node, given the motion before it; all of it in a relaxed programme, which has the
   rows as a cost. 0 where the rows lack rank. */
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
        int start = i == 0 && !w->free, counted = w->counts[i], rank = 0;
        w->directions[i] = start ? 0 : K;
        if (!counted) {
            for (int j = 0; j < K && !start; j++) motion[j][NX + j] = 1.0;
            continue;
        }
        for (int r = 0; r < N; r++) {
            right[r] = w->f[i][r];
            for (int d = 0; d < 3; d++)
                for (int j = 0; j < K; j++) right[r] -= w->by[i][d][r * K + j] * w->at[d][i * K + j];
            right[r] /= w->row_unit[r];
            for (int j = 0; j < K; j++) {
                double es = -w->by[i][0][r * K + j] * us[j] / w->row_unit[r], ed = -w->by[i][1][r * K + j] * ud[j] / w->row_unit[r];
                double ea = -w->by[i][2][r * K + j] * ua[j] / w->row_unit[r];
                if (start) {   /* all of the motion is given */
                    by_before[r][j] = es, by_before[r][K + j] = ed, by_before[r][2 * K + j] = ea;
                    rows[r][j] = 0.0;
                    continue;
                }
                w->soft[i][r][j] = es, w->soft[i][r][K + j] = ed, w->soft[i][r][2 * K + j] = ea;
                double alpha = w->alpha[i][j], gamma = w->gamma[i][j], delta = w->delta[i][j];
                by_before[r][j] = es;
                by_before[r][K + j] = es * alpha + ed;
                by_before[r][2 * K + j] = es * 2.0 * gamma + ed * delta;
                rows[r][j] = ea + es * gamma + ed * delta;
            }
            for (int c = 0; c < M; c++) rows[r][K + c] = w->W[i][r * M + c] * ut / w->row_unit[r];
        }
        if (start) {   /* all but the direction that W loses: what the given start leaves of f there is beyond this plan */
            double u[N], norm = 0.0;
            spectrum(g, w->W[i], u, 0);
            for (int p = 0; p < N; p++) u[p] *= w->row_unit[p], norm += u[p] * u[p];
            for (int p = 0; p < N; p++) u[p] /= sqrt(norm);
            for (int c = 0; c < NF + NX + 1; c++) {
                double along = 0.0;
                for (int p = 0; p < N; p++) along += u[p] * (c < NF ? rows[p][c] : c < NF + NX ? by_before[p][c - NF] : right[p]);
                for (int p = 0; p < N; p++) *(c < NF ? &rows[p][c] : c < NF + NX ? &by_before[p][c - NF] : &right[p]) -= u[p] * along;
            }
        }
        if (w->relaxed) {
            int first = start ? K : 0;
            for (int r = 0; r < N; r++) {
                for (int c = 0; c < NX && start; c++) w->soft[i][r][c] = by_before[r][c];
                memcpy(w->soft[i][r] + NX, rows[r] + K, M * sizeof *rows[r]);
                w->soft_right[i][r] = right[r];
            }
            for (int e = first; e < NF; e++) motion[e][NX + e - first] = 1.0;
            w->directions[i] = NF - first;
            continue;
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
            if (!(sqrt(most) > DEPENDENT * scale)) break;
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
    set_by_free(w);
    return 1;
}

static void set_bound(Work *w, int place, double bound) {
    w->active[place] = isfinite(bound) && bound < NO_LIMIT;
    w->bound[place] = w->active[place] > 0.0 ? bound : 0.0;
}

static void set_row(Work *w, int block, int lane, double a, double b, double c, double low, double high) {
    w->a[0][block][lane] = a, w->a[1][block][lane] = b, w->a[2][block][lane] = c;
    set_bound(w, block_at(block) + lane, high);
    set_bound(w, block_at(block) + LANES + lane, -low);
}

/* Limits of a carrier that starts beyond one, of a relaxed programme: with room for turning and going back by a part of the acceleration;
   no other has any. */
static void give_room(const Given *g, const Work *w, int j, double *low, double *high, double *speed) {
    double s = w->given[0][j], sd = w->given[1][j], h = w->node[1] - w->node[0];
    double most = smaller(g->acceleration[j], MOST_ACCELERATION), turn = TURNING * most * h;
    double moved = h * fabs(sd) + h * h / 6.0 * most + 0.5 * sd * sd / most;
    int above = s + moved > high[j], below = s - moved < low[j], fast = fabs(sd) > g->speed[j];
    for (int i = 0; i < COUNT; i++) {
        double after = w->node[i] - w->node[0], back = turn * after - 0.5 * GO_BACK * most * after * after + BEYOND;
        if (above) high[i * K + j] = larger(high[i * K + j], s + sd * after + back);
        if (below) low[i * K + j] = smaller(low[i * K + j], s + sd * after - back);
        if (fast) speed[i * K + j] = larger(speed[i * K + j], fabs(sd) + turn - GO_BACK * most * after);
    }
}

/* Costs and bounds. 0 where the given start breaks one. */
static int set_programme(const Given *g, Work *w) {
    const double *us = g->unit, *ud = us + K, *ua = ud + K;
    const double *weight = g->weight;
    int end = COUNT - 1;
    while (end > 1 && !w->known[end]) end--;   /* what is after the horizon is not known */
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
            low[i * K + j] = g->track[2 * j] + closer * us[j];
            high[i * K + j] = g->track[2 * j + 1] - closer * us[j];
            speed[i * K + j] = g->speed[j] * (1.0 - closer);
        }
    for (int j = 0; j < K && w->relaxed; j++) give_room(g, w, j, low, high, speed);
    for (int l = 0; l < LANES; l++) low[l] /= us[l % K], high[l] /= us[l % K], speed[l] /= ud[l % K];
    for (int i = 0; i < COUNT; i++) {
        double share = ((i ? w->h[i - 1] : 0.0) + w->h[i]) / whole;
        double closer = CLOSER * (w->node[i] - w->node[0]) / whole;
        int last = i == COUNT - 1;
        w->tau_cost[i] = weight[EFFORT] * share;
        for (int j = 0; j < K; j++) {
            int lane = i * K + j;
            double h = w->h[i], before = i ? w->h[i - 1] : 0.0;
            w->cost[0][0][lane] += CONVEX + weight[CENTRE] * share + (i == end ? 2.0 * weight[END] : 0.0);
            w->cost[1][1][lane] += CONVEX + (i == end ? 2.0 * weight[END_SPEED] : 0.0);
            w->cost[2][2][lane] += weight[ACCELERATED] * share;
            double by = weight[JERKED] * g->step / g->horizon * g->step;
            if (i) w->cost[2][2][lane] += 2.0 * by / before;
            if (!last) w->cost[2][2][lane] += 2.0 * by / h, w->cross[lane] = -2.0 * by / h;
            if (!i && !w->free) {
                if (w->known[0] && isfinite(g->carrier_force[j]) && !w->relaxed) {   /* all is given */
                    double now = w->force[0][j] / g->carrier_force[j];
                    for (int d = 0; d < 3; d++)
                        now += w->by_force[0][d][j] * (w->given[d][j] - w->at[d][j]) / g->carrier_force[j];
                    if (fabs(now) > FORCE_KEPT + PRECISION) return 0;
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
            }
            if (i ? !last : w->free)   /* else that of the first half step is given */
                set_row(w, SPEED, lane, 0.0, 1.0, h * 0.5 * ua[j] / ud[j], -speed[lane], speed[lane]);
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
    w->peak_cost = CONVEX + 2.0 * weight[PEAK];
    return 1;
}

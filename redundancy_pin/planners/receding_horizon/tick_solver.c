/* The solver: an interior point method, a Riccati recursion in each of its steps. */

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

/* The duals of the last programme at the nodes that both have, by bounds of a node: ``width`` of them from ``place`` on. */
static void remember(Work *w, const int *old, int place, int width) {
    for (int i = 0; i < COUNT; i++)
        for (int l = 0; l < width; l++) w->dual[place + i * width + l] = old[i] < 0 ? 0.0 : w->old_dual[place + old[i] * width + l];
}

/* A first point: sdd as near as it may be to those of the plan that all is linear about. */
static void begin(const Given *g, Work *w, int warm) {
    const double *ua = g->unit + 2 * K;
    int old[COUNT];
    for (int i = 0, o = 0; i < COUNT; i++) {
        while (o < COUNT && w->old_node[o] < w->node[i] - SAME) o++;
        old[i] = warm && o < COUNT && w->old_node[o] <= w->node[i] + SAME ? o : -1;
    }
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
            if (old[i] >= 0)
                for (int c = 0; c < M; c++)
                    rhs[p] += DAMPING * w->motion[i][K + c][NX + p] * (w->old_tau[old[i] * M + c] / w->tau_unit - free[K + c]);
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
    if (warm) {
        memcpy(w->dual, w->old_dual, sizeof w->dual);
        for (int b = 0; b < w->blocks; b++)
            for (int side = 0; side < 2; side++) remember(w, old, block_at(b) + side * LANES, K);
        for (int side = 0; side < 2; side++) remember(w, old, PEAK_AT + side * EFFORTS, M);
        if (w->blocks == BLOCKS)
            for (int side = 0; side < 2; side++) remember(w, old, JERK_AT + side * LANES, K), remember(w, old, EFFORT_AT + side * EFFORTS, M);
        for (int c = 0; c < w->bounds; c++) {
            w->slack[c] = w->active[c] > 0.0 ? larger(w->bound[c] - w->g[c], WARM_SLACK) : 1.0;
            w->dual[c] = w->active[c] > 0.0 ? smaller(larger(w->dual[c], WARM_BARRIER / w->slack[c]), WARM_MOST / w->slack[c]) : 1.0;
        }
        return;
    }
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
        S[(b + 1) * (size + 1)] -= 1e-13;
        right[b + 1] += w->row_missing[b];
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

/* Mehrotra's predictor and corrector; whether an optimum is found. */
static int interior_point(const Given *g, Work *w, int warm) {
    begin(g, w, warm);
    double count = 0.0, inverse[BOUNDS];
    for (int c = 0; c < w->bounds; c++) count += w->active[c];
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
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
            w->row_missing[b] = x, rows = larger(rows, fabs(x));
        }
        memcpy(w->base, w->gradient[0], sizeof w->base);
        double base_peak = peak_gradient;
        if (barrier < BARRIER && most < PRECISION && rows < PRECISION && is_stationary(w, base_peak)) {
            memcpy(w->old_node, w->node, sizeof w->node);
            memcpy(w->old_dual, w->dual, sizeof w->dual);
            for (int l = 0; l < EFFORTS; l++) w->old_tau[l] = w->tau[l] * w->tau_unit;
            w->old = 1;
            return 1;
        }
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

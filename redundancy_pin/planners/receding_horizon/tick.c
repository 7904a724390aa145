/* One tick as ``tick.py``, ``ahead.py`` and ``programme.py`` have it, where every programme of it has a solution that
   keeps all limits. What has none, and the first tick, is left to them.

   In front of this stand N, M, K, TERMS and COUNT: coordinates, main actuators, carriers, terms of f, nodes; and the
   constants of those files, whose names they have; then tick_sight.c, tick_programme.c and tick_solver.c.

   The programme is condensed: with the motion before it given, W tau = f leaves of (sdd, tau) at a node the M + K - N
   directions of its null space, and s and sd follow. W alone may be singular: that [dW tau, df] is not is what carriers
   are for. What is left is a linear-quadratic problem with bounds, which an interior point method solves, a Riccati
   recursion in each of its steps; the largest effort and the rows of singular instants stand beside it as a border. */

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
    int fine[INSTANTS], at_node[COUNT];
    double value[INSTANTS][N + K], own[INSTANTS][M];
    plan->residual = plan->peak = 0.0;
    for (int i = 0; i < COUNT; i++)
        for (int c = 0; c < M && w->counts[i]; c++) plan->peak = larger(plan->peak, fabs(plan->tau[i * M + c]));
    for (int e = 0; e < w->early; e++) {
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
        double unused[N];
        fine[p] = spectrum(g, W, unused) > REGULAR * REGULAR;
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
    for (int e = 0; e < w->early && e <= FIRST; e++)
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
        if (i == COUNT || !w->counts[i] || (i < w->early && fine[at_node[i]])) continue;
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
static int planned(const Given *g, Work *w, const double *t, int count, Plan *plan) {
    const double *ua = g->unit + 2 * K;
    linearise(g, w);
    if (w->borders > BORDER - 2 || !condense(g, w) || !set_programme(g, w)) return 0;
    if (!(w->before && interior_point(g, w, 1)) && !interior_point(g, w, 0)) return 0;
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

EXPORTED long rp_tick_solution(void) { return sizeof(Solution); }

EXPORTED long rp_tick_work(void) { return sizeof(Work) + 2 * sizeof(Plan); }

/* Plans from ``now`` on: what ``RecedingHorizon`` gives, as far as it is ``OK``. */
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
        if (place < g->track[2 * j] - BEYOND || place > g->track[2 * j + 1] + BEYOND) return RELAXED;
        if (fabs(w->given[1][j]) > g->speed[j] + BEYOND) return RELAXED;
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
    w->iterations = 0;
    w->before = g->solution && g->nodes == COUNT;
    if (w->before) memcpy(w->node_before, g->node, sizeof w->node_before), memcpy(&w->solution, g->solution, sizeof w->solution);
    if (!planned(g, w, t, count, best)) return UNSOLVED;
    int halfway = 0;
    for (int done = 1; done < MOST_ROUNDS; done++) {
        int near = 0;
        for (long r = 0; r < g->roots; r++) near |= g->root[r] > now && g->root[r] < now + CONVERGED * g->step;
        if (best->left <= LINEAR && (best->residual <= EXACT * row || !near)) break;
        if (!halfway) memcpy(w->at, best->at, sizeof w->at), memcpy(w->multiplier, best->multiplier, sizeof w->multiplier);
        if (!planned(g, w, t, count, other)) return UNSOLVED;
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
    if (best->left > STUCK) return RELAXED;
    result->pieces = best->pieces;
    result->residual = best->residual, result->peak = best->peak, result->left = best->left;
    result->solution = w->solution, result->iterations = w->iterations;
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
    return OK;
}

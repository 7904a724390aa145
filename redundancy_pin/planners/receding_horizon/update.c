/* One plan: programmes about the last one until W tau = f is met, and what becomes of their solutions.

   The programme is condensed: with the motion before it given, W tau = f leaves of (sdd, tau) at a node the M + K - N
   directions of its null space, and s and sd follow. W alone may be singular: that [dW tau, df] is not is what carriers
   are for. What is left is a linear-quadratic problem with bounds, which an interior point method solves, a Riccati
   recursion in each of its steps; the largest effort and the rows of singular instants stand beside it as a border. */

/* The carriers' motion, and a stop behind it. */
static void set_pieces(const Given *g, const Work *w, Plan *plan) {
    double after[K + 1], duration[K];
    int stops = 1, last = COUNT - 1;
    after[0] = 0.0;
    for (int j = 0; j < K; j++) {
        duration[j] = fabs(plan->at[LANES + last * K + j]) / g->acceleration[j];
        if (duration[j] < SHORTEST_STOP) duration[j] = 0.0;
        int i = stops, same = 0;
        for (int o = 0; o < stops; o++) same |= w->node[last] + after[o] == w->node[last] + duration[j];   /* but for rounding */
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

/* Efforts and carriers' forces in the first steps. */
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
        int place = found(g->window, smaller(t[p], g->until));
        const double *W = W_at(g, place);
        extended(plan->edge, plan->piece, plan->pieces, t[p], s, sd, sdd);
        value_at(g, place, s, sd, sdd, value[p]);
        plan->force_time[p] = t[p];
        memcpy(plan->force + p * K, value[p] + N, K * sizeof(double));
        double unused[N];
        fine[p] = spectrum(g, W, unused, 0) > REGULAR * REGULAR;
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

/* Whether what is linear about ``w->at`` has a plan that keeps every limit, or if not the one that misses least. */
static int solve(const Given *g, Work *w, int relaxed) {
    w->relaxed = relaxed;
    if (!condense(g, w) || !set_programme(g, w)) return 0;
    return (!relaxed && w->before && interior_point(g, w, 1)) || interior_point(g, w, 0);
}

/* One programme about ``w->at``, and what is made of it; 0 where it has no solution. */
static int planned(const Given *g, Work *w, const double *t, int count, Plan *plan) {
    const double *ua = g->unit + 2 * K;
    linearise(g, w);
    w->rounds++;
    if ((w->beyond || !solve(g, w, 0)) && (g->strict || !solve(g, w, 1))) return 0;
    plan->relaxed = w->relaxed;
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
            plan->left = larger(plan->left, fabs(missed) / w->row_unit[r]);
        }
    }
    return 1;
}

/* Polynomials (2, pieces, c) through values (pieces + 1, c). */
static void set_linear(const double *t, const double *value, long pieces, int c, double *edge, double *piece) {
    memcpy(edge, t, (size_t)(pieces + 1) * sizeof *t);
    for (long i = 0; i < pieces; i++)
        for (int j = 0; j < c; j++) {
            piece[i * c + j] = (value[(i + 1) * c + j] - value[i * c + j]) / (t[i + 1] - t[i]);
            piece[(pieces + i) * c + j] = value[i * c + j];
        }
}

/* Sizes of W and f along a first motion, which unknowns and rows are divided by from then on. */
static void set_sizes(const Given *g, Work *w, Result *result) {
    double size[COUNT], largest = 1.0, wanted = SMALLEST_FORCE;
    int known = 0;
    for (int i = 0; i < COUNT; i++) {
        double value[N + K], slope[3][(N + K) * K], unused[N];
        slopes_at(g, w->place[i], w->at[0] + i * K, w->at[1] + i * K, w->at[2] + i * K, 0, value, slope, 0);
        /* where the platform rests, what a carrier's acceleration of 1 m/s^2 asks for */
        for (int l = 0; l < N * K; l++) wanted = larger(wanted, 0.1 * fabs(slope[2][l]));
        if (!w->known[i]) continue;
        for (int r = 0; r < N; r++) wanted = larger(wanted, fabs(value[r]) / g->row_scale[r]);
        spectrum(g, W_at(g, w->place[i]), unused, &largest);
        int j = known++;
        for (; j > 0 && size[j - 1] > sqrt(largest); j--) size[j] = size[j - 1];
        size[j] = sqrt(largest);
    }
    largest = known ? 0.5 * (size[known / 2] + size[(known - 1) / 2]) : 1.0;
    result->tau = wanted / largest;
    for (int r = 0; r < N; r++) result->row[r] = wanted * g->row_scale[r];
}

/* Where a plan begins. */
static void set_start(const Given *g, Work *w, double coming) {
    double s[K] = {0}, sd[K] = {0}, sdd[K] = {0};
    if (!g->first) extended(g->edge, g->piece, g->edges - 1, w->node[0], s, sd, sdd);
    int settled = !g->first && coming <= g->now + SETTLED * g->step;
    w->free = (int)g->first, w->beyond = 0;
    for (int j = 0; j < K; j++) {
        w->given[0][j] = isnan(g->s[j]) || settled ? s[j] : g->s[j];
        w->given[1][j] = isnan(g->sd[j]) || settled ? sd[j] : g->sd[j];
        w->given[2][j] = sdd[j];
        double place = w->given[0][j];
        w->beyond |= place < g->track[2 * j] - BEYOND || place > g->track[2 * j + 1] + BEYOND;
        w->beyond |= fabs(w->given[1][j]) > g->speed[j] + BEYOND;
    }
}

/* What the first programme is linear about: the last plan, or carriers that stay where they start. */
static void begin_about_last(const Given *g, Work *w) {
    memset(w->multiplier, 0, sizeof w->multiplier);
    int same = (int)g->same_time;
    for (int i = 0; i < COUNT && same; i++) same = g->node[i] == w->node[i];
    for (int i = 0; i < COUNT; i++) {
        for (int d = 0; d < 3 && g->first; d++) memcpy(w->at[d] + i * K, w->given[d], sizeof w->given[d]);
        if (g->first) continue;
        extended(g->edge, g->piece, g->edges - 1, w->node[i], w->at[0] + i * K, w->at[1] + i * K, w->at[2] + i * K);
        for (int o = 0; o < COUNT; o++)
            if (fabs(g->node[o] - w->node[i]) <= SAME) memcpy(w->multiplier + i * N, g->multiplier + o * N, N * sizeof(double));
    }
    if (same) memcpy(w->at, g->at, sizeof w->at);
}

/* Another motion to be linear about, each time another one: to rest nearby, in the middle of the tracks, towards a corner. */
static void begin_about_guess(const Given *g, Work *w) {
    double s[K], sd[K], sdd[K], duration = g->until - g->now;
    long which = g->guesses % (2 + (1L << K));
    extended(g->edge, g->piece, g->edges - 1, g->now, s, sd, sdd);
    memset(w->multiplier, 0, sizeof w->multiplier);
    for (int j = 0; j < K; j++) {
        double low = g->track[2 * j], high = g->track[2 * j + 1];
        if (!isfinite(low) || !isfinite(high)) low = high = s[j];
        double target = s[j] + 0.5 * sd[j] * fabs(sd[j]) / g->acceleration[j];
        if (which > 0) target = 0.5 * (low + high);
        if (which > 1) target += ((which - 2) >> (K - 1 - j) & 1 ? ASIDE : -ASIDE) * 0.5 * (high - low);
        /* a polynomial of degree five that comes to rest */
        double way = target - s[j], v = sd[j] * duration, a = sdd[j] * duration * duration;
        const double c[6] = {s[j], v, 0.5 * a, 10.0 * way - 6.0 * v - 1.5 * a, -15.0 * way + 8.0 * v + 1.5 * a, 6.0 * way - 3.0 * v - 0.5 * a};
        for (int i = 0; i < COUNT; i++) {
            double x = duration > 0.0 ? smaller((w->node[i] - g->now) / duration, 1.0) : 1.0, value[3] = {0};
            for (int d = 5; d >= 0; d--)
                value[2] = value[2] * x + 2.0 * value[1], value[1] = value[1] * x + value[0], value[0] = value[0] * x + c[d];
            int moves = x < 1.0;
            w->at[0][i * K + j] = value[0];
            w->at[1][i * K + j] = moves ? value[1] / duration : 0.0;
            w->at[2][i * K + j] = moves ? value[2] / (duration * duration) : 0.0;
        }
    }
}

/* What a plan misses of f; not less than a bit where a limit kept the programme from an answer: it may come no nearer. */
static double doubt(const Plan *plan) { return plan->relaxed ? larger(plan->left, STUCK) : plan->left; }

/* As many programmes as it takes, each linear about the plan of the one before, or half way to it where that came no
   nearer. The best plan is left in ``plan[0]``; 0 where there is none. */
static int plan_rounds(const Given *g, Work *w, const double *t, int count, int refused, Plan **plan) {
    double row = 0.0;
    int near = 0, least = g->first ? FIRST_ROUNDS : 1;
    for (int i = 0; i < N; i++) row = larger(row, w->row_unit[i]);
    for (long r = 0; r < g->roots; r++) near |= g->root[r] > g->now && g->root[r] < g->now + CONVERGED * g->step;
    if (!planned(g, w, t, count, plan[0])) return 0;
    for (int done = 1, halfway = 0; done < MOST_ROUNDS; done++) {
        Plan *best = plan[0], *other = plan[1];
        int met = refused || (!best->relaxed && best->left <= LINEAR && (best->residual <= EXACT * row || !near));
        if (done >= least && met) break;
        if (!halfway) memcpy(w->at, best->at, sizeof w->at), memcpy(w->multiplier, best->multiplier, sizeof w->multiplier);
        if (!planned(g, w, t, count, plan[1])) return !g->strict;
        halfway = doubt(other) > larger(doubt(best), LINEAR);
        if (halfway) {   /* too far: f is linear nearer to the best so far */
            for (int d = 0; d < 3; d++)
                for (int l = 0; l < LANES; l++) w->at[d][l] = 0.5 * (best->at[d * LANES + l] + other->at[d * LANES + l]);
            for (int l = 0; l < COUNT * N; l++) w->multiplier[l] = 0.5 * (best->multiplier[l] + other->multiplier[l]);
            continue;
        }
        int stuck = other->relaxed && doubt(other) > SLOW * doubt(best);   /* as near as it comes */
        plan[0] = other, plan[1] = best;
        if (stuck) break;
    }
    return 1;
}

static int is_short(const Plan *plan) { return plan->relaxed || plan->left > STUCK; }

/* The largest effort until the next update. */
static double largest_soon(const Given *g, const Plan *plan) {
    double largest = 0.0;
    for (int i = 0; i < 5; i++) {
        double time = g->now + 0.25 * i * g->step;
        long e = 0;
        while (e < plan->efforts - 2 && plan->effort_time[e + 1] <= time) e++;
        double fraction = (time - plan->effort_time[e]) / (plan->effort_time[e + 1] - plan->effort_time[e]);
        fraction = smaller(larger(fraction, 0.0), 1.0);
        for (int c = 0; c < M; c++) {
            double x = plan->effort[e * M + c], y = plan->effort[(e + 1) * M + c];
            largest = larger(largest, fabs(x + fraction * (y - x)));
        }
    }
    return largest;
}

static void give(const Given *g, const Work *w, const Plan *plan, Result *result) {
    result->pieces = plan->pieces, result->relaxed = plan->relaxed;
    result->residual = plan->residual, result->peak = plan->peak, result->left = plan->left;
    result->solution = w->solution, result->rounds = w->rounds;
    memcpy(result->at, plan->at, sizeof plan->at);
    memcpy(result->multiplier, plan->multiplier, sizeof plan->multiplier);
    memcpy(result->edge, plan->edge, sizeof plan->edge);
    memcpy(result->piece, plan->piece, sizeof plan->piece);
    set_linear(plan->effort_time, plan->effort, result->efforts = plan->efforts - 1, M, result->effort_edge, result->effort);
    set_linear(plan->force_time, plan->force, result->forces = plan->forces - 1, K, result->force_edge, result->force);
    result->largest = largest_soon(g, plan);
}

/* Plans from ``now`` on. OK: within every limit. RELAXED: what misses W tau = f least. REFUSED: up to where the preview
   leads where the machine cannot go. UNSOLVED: there is no plan; nor is one that does not keep every limit if it has to be
   ``strict``. STOPPED: by who evaluates W and f. */
static int plan_from_now(const Sight *v, const Given *g, Result *result, Work *w, Plan *first) {
    Plan *plan[3] = {first, first + 1, first + 2};
    double t[INSTANTS], coming = INFINITY;
    for (long r = 0; r < g->roots; r++)
        if (g->root[r] > g->now - SAME) coming = smaller(coming, g->root[r]);
    w->start = coming <= g->now + NEAR_ROOT * g->step && !g->first ? coming : g->now;
    set_nodes(g, w);
    int count = set_instants(g, w, t);
    if (!look_up(v, g, w, t, count)) return STOPPED;
    memcpy(result->node, w->node, sizeof w->node);
    int known = 1, refused = 0;
    result->known = COUNT;
    for (int i = 0; i < COUNT; i++) {
        int in_sight = w->node[i] <= g->until + SAME;
        known = known && g->window->reachable[w->place[i]];
        w->known[i] = known && in_sight;
        if (!w->known[i] && result->known == COUNT) result->known = i, refused = in_sight;
        w->counts[i] = w->known[i] && (i || g->first || w->is_singular[0]);
    }
    if (refused && g->strict) return UNSOLVED;
    set_start(g, w, coming);
    if (w->beyond && g->strict) return UNSOLVED;
    begin_about_last(g, w);
    if (g->first) set_sizes(g, w, result);
    else result->tau = g->tau, memcpy(result->row, g->row, sizeof result->row);
    memcpy(w->row_unit, result->row, sizeof w->row_unit);
    w->tau_unit = result->tau * (g->first ? 1.0 : smaller(larger(g->peak / g->tau, SMALLEST), 1.0));
    w->rounds = 0;
    w->before = !g->first;
    if (w->before) memcpy(w->node_before, g->node, sizeof w->node_before), w->solution = *g->solution;
    if (!plan_rounds(g, w, t, count, refused, plan)) return UNSOLVED;
    if (g->strict && is_short(plan[0])) return UNSOLVED;
    give(g, w, plan[0], result);
    result->guessed = 0;
    if (is_short(plan[0]) && !refused && !g->first) {   /* it may be stuck where W tau = f is missed least nearby */
        Plan *others[2] = {plan[1], plan[2]};
        begin_about_guess(g, w);
        result->guessed = 1;
        if (plan_rounds(g, w, t, count, refused, others) && doubt(others[0]) < doubt(plan[0])) plan[0] = others[0], give(g, w, plan[0], result);
    }
    return refused ? REFUSED : is_short(plan[0]) ? RELAXED : OK;
}

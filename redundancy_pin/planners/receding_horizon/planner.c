/* Update after update: what is kept between them, limits between the nodes, and the platform's speed along its path. */

enum { NOTHING, NOT_FOUND, LIMITS, FORCE_MISSING, UNREACHABLE, SPEED_BETWEEN, FORCE_BETWEEN, EFFORT_BETWEEN };   /* reasons */

typedef struct {
    double step, horizon, row_scale[N], weight[UNMET + 1];
    double track[2 * K], speed[K], acceleration[K], jerk[K], carrier_force[K], effort[M];
} Settings;

typedef struct {
    Settings settings;
    long slows, started, guesses, current, seen, number, changes;
    double unit[3 * K], tau, row[N], largest, held_until, broken[BREAKS];
    Scaling scaling, other_scaling;
    Result result[2];   /* that of the last update, and the next one */
    Window window[2];
    Work work;
    Plan plan[3];
} Planner;

static Result *last_of(Planner *p) { return &p->result[p->current]; }

static Sight sight_of(Planner *p, int other, const Preview *preview, const Scaling *scaling) {
    Sight v = {&p->window[other ? !p->seen : p->seen], preview, scaling, p->settings.step, p->settings.row_scale};
    return v;
}

/* --- a plan -------------------------------------------------------------------------------------------------------- */

/* The piece of a function that begins at a time, or ends there. */
static long piece_at(const double *edge, long pieces, double time, int left) {
    long i = 0;
    while (i < pieces - 1 && (left ? edge[i + 1] < time : edge[i + 1] <= time)) i++;
    return i;
}

static void value_of(int order, int width, const double *edge, const double *piece, long pieces, double time, double *value) {
    long i = piece_at(edge, pieces, time, 0);
    double x = smaller(larger(time, edge[0]), edge[pieces]) - edge[i];
    for (int j = 0; j < width; j++) {
        value[j] = 0.0;
        for (int d = 0; d < order; d++) value[j] = value[j] * x + piece[(d * pieces + i) * width + j];
    }
}

/* The new function with its beginning: to the singular instant where its plan starts it is the last one's. From there on efforts
   are linear up to the first instant at which W⁻¹ f is known: just behind a singular one it is not, and their value at the start,
   where the acceleration is given, is that of the last plan. Returns the number of its pieces, at most `room`. */
static long begun_with(int order, int width, long pieces, const double *edge, const double *piece, double t, double start, long own,
                       double *to_edge, double *to, long room) {
    double begins = to_edge[0], end = edge[pieces];
    int link = begins > start + SAME, held = start > larger(t, end) + SAME;   /* behind its end the last one is held */
    long first = piece_at(edge, pieces, t, 0), many = start > t + SAME && t < end - SAME ? piece_at(edge, pieces, start, 1) - first + 1 : 0;
    if (many > room - own - held - link) first += many - (room - own - held - link), many = room - own - held - link;
    long more = many + held + link, total = more + own;
    if (!more) return own;
    memmove(to_edge + more, to_edge, (size_t)(own + 1) * sizeof *to_edge);
    for (int d = order - 1; d >= 0; d--) memmove(to + (d * total + more) * width, to + d * own * width, (size_t)(own * width) * sizeof *to);
    for (int d = 0; d < order; d++)
        for (long i = 0; i < many; i++) memcpy(to + (d * total + i) * width, piece + (d * pieces + first + i) * width, (size_t)width * sizeof *to);
    for (int j = 0; j < width && many; j++) shift(to + j, order, total * width, larger(t - edge[first], 0.0));
    for (long i = 0; i < many; i++) to_edge[i] = larger(t, edge[first + i]);
    if (held) {
        to_edge[many] = larger(t, end);
        for (int d = 0; d < order - 1; d++) memset(to + (d * total + many) * width, 0, (size_t)width * sizeof *to);
        value_of(order, width, edge, piece, pieces, end, to + ((order - 1) * total + many) * width);
        many++;
    }
    to_edge[many] = start;
    if (link) {
        double before[M > K ? M : K];
        value_of(order, width, edge, piece, pieces, start, before);
        for (int d = 0; d < order - 2; d++) memset(to + (d * total + many) * width, 0, (size_t)width * sizeof *to);
        for (int j = 0; j < width; j++) {
            to[((order - 2) * total + many) * width + j] = (to[((order - 1) * total + more) * width + j] - before[j]) / (begins - start);
            to[((order - 1) * total + many) * width + j] = before[j];
        }
    }
    return total;
}

/* A plan that starts at a singular instant after the update begins with the last one. */
static void set_beginning(const Result *last, Result *made) {
    double start = made->node[0], t = made->t;
    if (start <= t + SAME && made->effort_edge[0] <= start + SAME) return;
    made->pieces = begun_with(4, K, last->pieces, last->edge, last->piece, t, start, made->pieces, made->edge, made->piece, CARRIER_PIECES);
    made->efforts = begun_with(2, M, last->efforts, last->effort_edge, last->effort, t, start, made->efforts, made->effort_edge, made->effort, EFFORT_PIECES);
    made->forces = begun_with(2, K, last->forces, last->force_edge, last->force, t, start, made->forces, made->force_edge, made->force, FORCE_PIECES);
    for (long i = 0; i < made->efforts && (!i || made->effort_edge[i] <= start); i++)   /* between them efforts are linear */
        for (int c = 0; c < M; c++) made->largest = larger(made->largest, fabs(made->effort[(made->efforts + i) * M + c]));
}

/* Whether a carrier exceeds its speed until a time. */
static int is_fast(const Given *g, const Result *r, double end) {
    double s[K], sd[K], sdd[K];
    int may = 0;
    extended(r->edge, r->piece, r->pieces, r->t, s, sd, sdd);
    for (int j = 0; j < K; j++) may |= fabs(sd[j]) + 0.5 * g->step * fabs(sdd[j]) > g->speed[j];
    for (long i = piece_at(r->edge, r->pieces, r->t, 0); may && i < r->pieces && r->edge[i] < end; i++)
        for (int j = 0; j < K; j++) {
            double from = larger(r->t, r->edge[i]) - r->edge[i], to = smaller(end, r->edge[i + 1]) - r->edge[i];
            double a = 3.0 * r->piece[i * K + j], b = 2.0 * r->piece[(r->pieces + i) * K + j], c = r->piece[(2 * r->pieces + i) * K + j];
            double peak = a != 0.0 ? smaller(larger(-0.5 * b / a, from), to) : from, most = g->speed[j] * (1.0 + SAME_SPEED);
            if (fabs((a * from + b) * from + c) > most || fabs((a * to + b) * to + c) > most || fabs((a * peak + b) * peak + c) > most) return 1;
        }
    return 0;
}

/* Status and residual of a command that know of the limits up to the next node, which may not show them.

   Between nodes f and the carriers' forces may be larger than at them, above all where the acceleration jumps: the efforts are cut
   off then, the forces are not. The programme does not bound the speed of the first half step, which is given. 0 where the update is
   to end. */
static int check_between(const Sight *v, const Given *g, const double *row, Result *r) {
    double soon = r->t + g->step, end = smaller(soon, r->edge[r->pieces]), t[INSTANTS], meets[INSTANTS] = {0}, cut = 0.0;
    int bounded = 0, many = 1, met = 0;
    if (r->status != OK) return 1;
    if (end > r->t && is_fast(g, r, end)) {
        r->status = RELAXED, r->reason = SPEED_BETWEEN;
        return 1;
    }
    for (int c = 0; c < M; c++) bounded |= isfinite(g->effort[c]);
    for (int j = 0; j < K; j++) bounded |= isfinite(g->carrier_force[j]);
    if (!bounded) return 1;
    t[0] = r->t;
    if (r->known_until > r->t) {
        const double ends[2] = {r->t, r->known_until};
        int near = r->known_until <= soon + SAME;
        many = instants_between(g, ends, 1 + near, near ? r->known_until : smaller(r->known_until, soon + 2.0 * BESIDE + SAME), t);
    }
    for (int i = 0; i < many; i++) {
        double force[K], effort[M];
        int meets_one = 0;
        if (t[i] > soon + SAME) continue;
        value_of(2, K, r->force_edge, r->force, r->forces, t[i], force);
        value_of(2, M, r->effort_edge, r->effort, r->efforts, t[i], effort);
        for (int j = 0; j < K; j++)
            if (fabs(force[j]) > g->carrier_force[j] * (1.0 + LIMIT_TOLERANCE)) {
                r->status = RELAXED, r->reason = FORCE_BETWEEN;
                return 1;
            }
        for (int c = 0; c < M; c++) meets_one |= fabs(effort[c]) >= g->effort[c] * (1.0 - AT_LIMIT);
        if (meets_one) meets[met++] = t[i];
    }
    if (!ensure(v, meets, met)) return 0;
    for (int i = 0; i < met; i++) {
        double s[K], sd[K], sdd[K], value[N + K], effort[M];
        int place = found(v->window, meets[i]);
        extended(r->edge, r->piece, r->pieces, meets[i], s, sd, sdd);
        value_at(g, place, s, sd, sdd, value);
        value_of(2, M, r->effort_edge, r->effort, r->efforts, meets[i], effort);
        for (int q = 0; q < N; q++) {
            double missing = -value[q];
            for (int c = 0; c < M; c++) missing += W_at(g, place)[q * M + c] * effort[c];
            cut = larger(cut, fabs(missing) / g->row_scale[q]);
        }
    }
    double largest = 0.0;
    for (int q = 0; q < N; q++) largest = larger(largest, row[q]);
    r->residual = larger(r->residual, cut);
    if (cut > CUT_OFF * largest) r->status = RELAXED, r->reason = EFFORT_BETWEEN;
    return 1;
}

/* A plan from a time on about the last one, in the other result; of ``strict`` ones none that does not keep every limit. */
static int attempt(Planner *p, const Sight *v, double t, const double *s, const double *sd, int strict) {
    Result *last = last_of(p), *made = &p->result[!p->current];
    const Settings *own = &p->settings;
    Window *w = v->window;
    double until = smaller(t + own->horizon, clock_at(v->scaling, v->preview->end));
    long ahead = 0;
    if (!look(v, t, until)) return STOPPED;
    for (long r = 0; r < w->roots; r++)   /* rows for no more of them: what is behind is not planned yet */
        if (w->root[r] > t - SAME && ++ahead == MOST_SINGULAR + 1) until = smaller(until, w->root[r] - own->step);
    Given g = {
        last->pieces + 1, w->roots, 0, w->sharps, p->started && last->t == t, !p->started, strict, p->guesses, w,
        last->edge, last->piece, last->node, last->at, last->multiplier, &last->solution, w->root,
        p->broken, w->sharp, own->row_scale, p->row, own->track, own->speed, own->acceleration, own->jerk, own->carrier_force, own->effort,
        p->unit, own->weight, s, sd, t, until, own->step, own->horizon, p->tau, p->largest, last->peak};
    double first, final, unused, after = t + (FIRST + 2) * own->step;
    sigma_at(v->scaling, t - own->step, &first, &unused, &unused), sigma_at(v->scaling, after, &final, &unused, &unused);
    for (long b = 0; b < v->preview->breaks && g.breaks < BREAKS; b++)
        if (v->preview->broken[b] > first && v->preview->broken[b] < final) p->broken[g.breaks++] = clock_at(v->scaling, v->preview->broken[b]);
    int status = plan_from_now(v, &g, made, &p->work, p->plan);
    if (status == UNSOLVED || status == STOPPED) return status;
    made->t = t, made->status = status, made->reason = NOTHING, made->singulars = 0;
    if (status == RELAXED) made->reason = made->relaxed ? LIMITS : FORCE_MISSING;
    if (status == REFUSED) {
        made->reason = UNREACHABLE;
        sigma_at(v->scaling, made->node[made->known], &made->blocked, &unused, &unused);
    }
    made->known_until = made->node[made->known > 1 ? made->known - 1 : 0];
    for (long r = 0; r < w->roots; r++)
        if (w->root[r] > t - SAME) made->singular[made->singulars++] = w->root[r];
    if (p->started) set_beginning(last, made);
    if (!check_between(v, &g, made->row, made)) return STOPPED;
    return strict && made->status != OK ? UNSOLVED : (int)made->status;
}

/* Keep the plan that was made. */
static void keep_plan(Planner *p) {
    p->current = !p->current;
    Result *last = last_of(p);
    if (!p->started) p->tau = last->tau, memcpy(p->row, last->row, sizeof p->row);
    p->started = 1, p->guesses += last->guessed, p->largest = larger(p->largest, last->largest);
}

static int update_along(Planner *p, const Sight *v, double t, const double *s, const double *sd) {
    int status = attempt(p, v, t, s, sd, 0);
    if (status == STOPPED || (status == UNSOLVED && !p->started)) return status;
    if (status != UNSOLVED) {
        keep_plan(p);
        return status;
    }
    Result *last = last_of(p);
    last->t = t, last->status = FALLBACK, last->reason = NOT_FOUND, last->left = INFINITY;
    return FALLBACK;
}

/* --- slowing down -------------------------------------------------------------------------------------------------- */

/* From when on the rate may change: next to a singular instant the last plan goes on. */
static double may_change_from(Planner *p, double t) {
    const Window *w = &p->window[p->seen];
    const Result *last = last_of(p);
    double near = -INFINITY, from = t - p->settings.step, to = t + CONVERGED * p->settings.step;
    for (long r = 0; r < w->roots; r++)
        if (w->root[r] > from && w->root[r] < to) near = larger(near, w->root[r]);
    for (long r = 0; p->started && r < last->singulars; r++)   /* of another preview, none has come into sight yet */
        if (last->singular[r] > from && last->singular[r] < to) near = larger(near, last->singular[r]);
    return larger(t, near + 0.5 * p->settings.step);
}

/* A reference governor (E. Gilbert, I. Kolmanovsky and K. T. Tan, 1995) in time: of some changes of the speed along the preview, the
   first counts that has a plan within every limit; mild ones are tried first. Its rate is continuous, so that the efforts are. */
static int update_slowing(Planner *p, const Preview *preview, double t, const double *s, const double *sd) {
    enum { TRIED = sizeof SLOWER / sizeof *SLOWER + 4 };
    double wanted[TRIED], part[TRIED], begins = may_change_from(p, t), final = final_rate(&p->scaling), sigma, rate, bend;
    int tried = 0;
    sigma_at(&p->scaling, begins, &sigma, &rate, &bend);
    if (final < FULL && t >= p->held_until) {
        p->held_until = t + HOLD * p->settings.step;
        wanted[tried] = 1.0, part[tried++] = RISE;
        wanted[tried] = smaller(final + FASTER, 1.0), part[tried++] = RISE;
        if (final < CREEPING) wanted[tried] = smaller(final + CREEPING, 1.0), part[tried++] = RISE;
    }
    wanted[tried] = final, part[tried++] = 0.0;   /* as it is */
    double slowest = smaller(rate, final);
    for (int i = 0; slowest > 0.0 && i < TRIED - 4; i++) {
        double by = SLOWER[i][0] * slowest;
        wanted[tried] = by >= LEAST_RATE ? by : 0.0, part[tried++] = SLOWER[i][1];
    }
    for (int i = 0; i < tried; i++) {
        int twice = 0;
        for (int j = 0; j < i; j++) twice |= wanted[j] == wanted[i] && part[j] == part[i];
        if (twice) continue;
        Sight v = sight_of(p, part[i] > 0.0, preview, part[i] > 0.0 ? &p->other_scaling : &p->scaling);
        if (part[i] > 0.0) {
            double least, most;
            change_rate(&p->scaling, begins, wanted[i], part[i] * p->settings.horizon, t - KEPT * p->settings.step, &p->other_scaling);
            rates_of(&p->other_scaling, &least, &most);
            if (least < FULL - 1.0 || most > 2.0 - FULL) continue;   /* back along the path, or faster than the preview */
            begin_window(v.window, &p->window[p->seen], t, p->settings.step);
        }
        int status = attempt(p, &v, t, s, sd, 1);
        if (status == STOPPED) return status;
        if (status == UNSOLVED) continue;
        if (part[i] > 0.0) p->scaling = p->other_scaling, p->seen = !p->seen, p->held_until = t + HOLD * p->settings.step, p->changes++;
        keep_plan(p);
        return OK;
    }
    Sight v = sight_of(p, 0, preview, &p->scaling);
    return update_along(p, &v, t, s, sd);
}

/* --- what is called ------------------------------------------------------------------------------------------------ */

/* Use limits and weights from the next update on. */
static void set_planner(Planner *p, const Settings *settings) {
    p->settings = *settings;
    for (int j = 0; j < K; j++) {
        double width = settings->track[2 * j + 1] - settings->track[2 * j];
        p->unit[j] = isfinite(width) ? 0.5 * width : 1.0;
        p->unit[K + j] = isfinite(settings->speed[j]) ? settings->speed[j] : 1.0;
        p->unit[2 * K + j] = isfinite(settings->acceleration[j]) ? settings->acceleration[j] : 10.0;
    }
}

/* Begin anew; `slows`: whether the platform may go more slowly where no plan keeps every limit. */
static void start_planner(Planner *p, const Settings *settings, long slows) {
    memset(p, 0, sizeof *p);
    set_planner(p, settings);
    p->slows = slows, p->number = -1, p->held_until = -INFINITY;
    clear(&p->window[0], -INFINITY, settings->step);
}

/* The preview's own time at a time of the clock. */
static double preview_time(const Planner *p, double t) {
    double sigma, rate, bend;
    sigma_at(&p->scaling, t, &sigma, &rate, &bend);
    return sigma;
}

/* Plan from a time on, not before the last one; s, sd (K): where the carriers are, NaN where the last plan is to be believed. The
   result is that of ``last_of``. UNSOLVED: a first plan was not found. STOPPED: the preview has no finite value, the planner was never
   started, or the clock is beyond LATEST. */
static int update_planner(Planner *p, double t, const Preview *preview, const double *s, const double *sd) {
    if (!(p->settings.step > 0.0) || !(fabs(t) <= LATEST)) return STOPPED;
    if (preview->number != p->number) {
        if (!p->started) {
            Window *w = &p->window[p->seen];
            w->largest = w->size = 0.0;
            clear(w, -INFINITY, p->settings.step);
        } else {
            begin_window(&p->window[!p->seen], &p->window[p->seen], t, p->settings.step);
            p->seen = !p->seen;
            p->window[p->seen].size = 0.0;   /* sharp turns are scanned as those of a first preview */
        }
        p->number = preview->number;
    }
    p->work.iterations = 0;   /* of all attempts, whatever is kept */
    Sight v = sight_of(p, 0, preview, &p->scaling);
    int status = p->slows ? update_slowing(p, preview, t, s, sd) : update_along(p, &v, t, s, sd);
    if (status == UNSOLVED || status == STOPPED) return status;
    Result *last = last_of(p);
    double sigma, rate, bend;
    sigma_at(&p->scaling, t, &sigma, &rate, &bend);
    last->changes = p->changes, last->so_far = p->largest, last->iterations = p->work.iterations;
    if (last->status == OK && p->changes && smaller(final_rate(&p->scaling), rate) < FULL) last->status = TIME_SCALED;
    return (int)last->status;
}

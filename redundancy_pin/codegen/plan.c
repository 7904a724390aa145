/* What a controller calls; see the header. This text follows the planner and SETTINGS; robot_ and ROBOT_ in it become the
   prefix. Nothing is static but constants, nothing is allocated, every loop has a bound. */

int robot_plan_begin(double *near, const double *x);
int robot_plan_terms(const double *numbers, int samples, const double *in, int width, double *near, double *out, double *sizes);

typedef struct {
    Planner planner;
    Preview preview;
    Polynomials motion;
    double near[NEAR_NUMBERS];
    long begun;
} Memory;

typedef char robot_plan_fits[sizeof(Memory) <= sizeof(robot_plan) ? 1 : -1];

static void command_at(const Memory *m, double t, robot_command *command) {
    const Result *last = &m->planner.result[m->planner.current];
    double bend, renewed = larger(last->known_until, last->t + m->planner.settings.step);
    command->status = t > renewed + SAME ? FALLBACK : (int)last->status; /* a plan that nobody has renewed */
    command->reason = (int)last->reason, command->iterations = (int)last->iterations;
    command->residual = last->residual, command->peak = last->peak, command->known_until = last->known_until;
    extended(last->edge, last->piece, last->pieces, t, command->s, command->sd, command->sdd);
    value_of(2, M, last->effort_edge, last->effort, last->efforts, t, command->tau);
    value_of(2, K, last->force_edge, last->force, last->forces, t, command->carrier_force);
    sigma_at(&m->planner.scaling, t, &command->preview_time, &command->preview_rate, &bend);
}

static int is_preview(const robot_preview *preview) {
    if (preview->pieces < 1 || preview->order < 1 || !preview->edges || !preview->coefficients) return 0;
    if (preview->breaks < 0 || (preview->breaks && !preview->break_times)) return 0;
    for (int i = 0; i < preview->pieces; i++)
        if (!(preview->edges[i] < preview->edges[i + 1])) return 0;
    double last = preview->edges[preview->pieces];
    int rests = preview->moves_until <= last;
    return isfinite(preview->edges[0]) && isfinite(last) && preview->end >= preview->edges[0] && !isnan(preview->moves_until) &&
           (rests || preview->end <= last + SAME); /* nothing says how a motion goes on behind its polynomials */
}

int robot_plan_reset(robot_plan *plan) {
    Memory *m = (Memory *)plan;
    memset(m, 0, sizeof *m);
    start_planner(&m->planner, &SETTINGS, SLOWS);
    return ROBOT_PLAN_OK;
}

int robot_plan_set_limits(robot_plan *plan, const robot_plan_limits *limits) {
    Memory *m = (Memory *)plan;
    Settings settings = m->planner.settings;
    if (!(settings.step > 0.0)) return ROBOT_PLAN_BAD_INPUT; /* never reset */
    for (int j = 0; j < K; j++) {
        if (!(limits->track[j][0] < limits->track[j][1]) || !(limits->speed[j] > 0.0)) return ROBOT_PLAN_BAD_INPUT;
        if (!(limits->acceleration[j] > 0.0) || !(limits->jerk[j] > 0.0) || !(limits->carrier_force[j] > 0.0)) return ROBOT_PLAN_BAD_INPUT;
        settings.track[2 * j] = limits->track[j][0], settings.track[2 * j + 1] = limits->track[j][1];
        settings.speed[j] = limits->speed[j], settings.acceleration[j] = limits->acceleration[j];
        settings.jerk[j] = limits->jerk[j], settings.carrier_force[j] = limits->carrier_force[j];
    }
    for (int c = 0; c < M; c++) {
        if (!(limits->effort[c] > 0.0)) return ROBOT_PLAN_BAD_INPUT;
        settings.effort[c] = limits->effort[c];
    }
    set_planner(&m->planner, &settings);
    return ROBOT_PLAN_OK;
}

int robot_plan_update(robot_plan *plan, double t, const robot_carriers *measured, const robot_preview *preview, robot_command *command) {
    Memory *m = (Memory *)plan;
    double s[K], sd[K], sigma = preview_time(&m->planner, t);
    int finite = is_preview(preview);
    for (int j = 0; j < K; j++) {
        s[j] = measured ? measured->s[j] : NAN, sd[j] = measured ? measured->sd[j] : NAN;
        finite = finite && (!measured || (isfinite(s[j]) && isfinite(sd[j])));
    }
    if (!finite || (m->planner.started && t < last_of(&m->planner)->t)) return ROBOT_PLAN_BAD_INPUT;
    if (!(sigma >= preview->edges[0] - SAME && sigma <= preview->end + SAME)) return ROBOT_PLAN_BAD_INPUT;
    m->motion.terms = robot_plan_terms, m->motion.near = m->near;
    m->motion.edge = preview->edges, m->motion.piece = preview->coefficients;
    m->motion.pieces = preview->pieces, m->motion.order = preview->order, m->motion.moves_until = preview->moves_until;
    m->preview.evaluate = evaluate_polynomials, m->preview.context = &m->motion;
    m->preview.start = preview->edges[0], m->preview.end = preview->end;
    m->preview.broken = preview->break_times, m->preview.breaks = preview->breaks, m->preview.number = preview->number;
    if (!m->begun) {
        double x[PLACES + 2 * N];
        platform_at(&m->motion, sigma, x);
        for (int c = 0; c < PLACES + 2 * N; c++)
            if (!isfinite(x[c])) return ROBOT_PLAN_BAD_INPUT;
        if (robot_plan_begin(m->near, x)) return ROBOT_PLAN_UNREACHABLE;
        m->begun = 1;
    }
    int status = update_planner(&m->planner, t, &m->preview, s, sd);
    if (status == STOPPED) return ROBOT_PLAN_BAD_INPUT; /* never reset, the clock, or a motion that is not finite ahead */
    if (status == UNSOLVED) return ROBOT_PLAN_NONE;
    command_at(m, t, command);
    return status;
}

int robot_plan_command_at(const robot_plan *plan, double t, robot_command *command) {
    const Memory *m = (const Memory *)plan;
    if (!isfinite(t)) return ROBOT_PLAN_BAD_INPUT;
    if (!m->planner.started) return ROBOT_PLAN_NONE;
    command_at(m, t, command);
    return command->status;
}

/* What Python calls. */

long rp_planner_size(void) { return sizeof(Planner); }

long rp_planner_solution(void) { return sizeof(Solution); }

void rp_planner_start(Planner *p, const Settings *settings, long slows) { start_planner(p, settings, slows); }

void rp_planner_set(Planner *p, const Settings *settings) { set_planner(p, settings); }

double rp_planner_sigma(const Planner *p, double t) { return preview_time(p, t); }

int rp_planner_update(Planner *p, double t, const Preview *preview, const double *s, const double *sd) {
    return update_planner(p, t, preview, s, sd);
}

const Result *rp_planner_result(const Planner *p) { return &p->result[p->current]; }

const Window *rp_planner_window(const Planner *p) { return &p->window[p->seen]; }

const Scaling *rp_planner_scaling(const Planner *p) { return &p->scaling; }

long rp_evaluate_polynomials(void *context, long count, const double *t, const double *sigma, const double *rate, const double *bend,
                             double *out) {
    return evaluate_polynomials(context, count, t, sigma, rate, bend, out);
}

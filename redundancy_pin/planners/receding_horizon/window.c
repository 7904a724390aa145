/* W tau = f at the instants ahead: where it is singular, and at the nodes of a plan linear in the carriers' motion.

   In front of this stand N, M, K, TERMS, STEPS and COUNT: coordinates, main actuators, carriers, terms of f, steps of the
   horizon, nodes of a plan; and the constants of ``constants.py``. Behind it: nodes.c, programme.c, solver.c, update.c,
   planner.c.

   Instants are fixed in time, an eighth of a step apart, so that each is evaluated once, when it comes into sight: there f
   is a sum of terms of the carriers' motion, and its values and slopes at any plan need no further evaluation.

   At a singular instant uᵀ W = 0, and tau is what W⁻¹ f tends to: uᵀ Ẇ tau = uᵀ ḟ, with the jerk of the step before and
   with that of the step after. With f linear, f = f̄ + F_s δs + F_ṡ δṡ + F_s̈ δs̈, and ′ the derivative by time along the
   motion that continues s̄ without jerk,

       ḟ = f̄′ + F_s′ δs + (F_s + F_ṡ′) δṡ + (F_ṡ + F_s̈′) δs̈ + F_s̈ s⃛. */

#include <math.h>
#include <string.h>

/* Vectors of numbers, as GCC and Clang have them, anywhere in arrays; for processors that have none as long they make them of
   shorter ones. With ROBOT_SCALAR, and by other compilers, numbers are taken one by one. */
#if defined(__GNUC__) && !defined(ROBOT_SCALAR)
enum { LONG = 4 };
typedef double __attribute__((vector_size(LONG * sizeof(double)), aligned(sizeof(double)), may_alias)) Vector;
typedef long long __attribute__((vector_size(LONG * sizeof(double)), aligned(sizeof(double)), may_alias)) Mask;
#define INLINE static inline __attribute__((always_inline))
#define NO_VECTOR ((Vector){0})
#define NO_VECTORS {{0}}
#define PART_OF(vector, l) (vector)[l]
#else
enum { LONG = 1 };
typedef double Vector;
#define INLINE static inline
#define NO_VECTOR 0.0
#define NO_VECTORS {0}
#define PART_OF(vector, l) (vector)
#endif

/* What an update may ask for beside the grid; the grid that is ahead; instants for which there is memory. */
enum { BESIDE_GRID = COUNT + 2 * MOST_SINGULAR + INSTANTS + 3 * MOST_ROOTS, GRID = PARTS * (STEPS + 1) + 4 };
enum { CAPACITY = 2 * GRID + KEPT * PARTS + BESIDE_GRID, WANTED = GRID + BESIDE_GRID };
enum { SUM = N + K, ALL = K * TERMS * SUM };

/* W (N, M), f and the carriers' forces at rest at s = 0 (N + K) and their terms (K, TERMS, N + K) at `count` increasing times t of
   the clock, at the preview's own time sigma with its derivatives: those of all, one after the other. Returns how many there are
   before the first that the machine cannot be at; -1 where the update is to end. */
typedef long Evaluate(void *context, long count, const double *t, const double *sigma, const double *rate, const double *bend, double *out);

/* The platform's motion ahead, in its own time. */
typedef struct {
    Evaluate *evaluate;
    void *context;
    double start, end;      /* between which it is known */
    const double *broken;   /* times at which the acceleration jumps, increasing */
    long breaks;
    long changing;          /* whether it may answer otherwise when asked again */
    long number;            /* of another preview another one */
} Preview;

/* The preview's time sigma by the clock's: polynomials of degree four, the highest power first; the last piece has no end. */
typedef struct {
    long pieces;   /* 0: both are the same */
    double edge[CURVE + 1], c[CURVE][5];
} Scaling;

typedef struct {
    long roots, sharps;
    double root[MOST_ROOTS], sharp[MOST_ROOTS];   /* singular instants; instants about which f of the parked machine bends most */
    long count, frees;                            /* instants in order of time, and which slot of the arrays below has them */
    double t[CAPACITY];
    int slot[CAPACITY], free[CAPACITY];
    unsigned char reachable[CAPACITY];
    double blocked;                               /* the first unreachable instant: no plan leads past it */
    long looked;                                  /* whether singular instants have been looked for, from begin to last */
    double begin, last;
    long determinants;                            /* of the last two instants of the grid */
    double edge[2], determinant[2], largest, size;
    long recents, bends;
    double recent_time[2 * PARTS + 1], recent[2 * PARTS + 1][N], bend_time[3], bend[3];
    double W[CAPACITY][N * M], constant[CAPACITY][SUM], terms[CAPACITY][ALL];
    double some[BATCH * (N * M + SUM + ALL)];
} Window;

typedef struct {
    Window *window;
    const Preview *preview;
    const Scaling *scaling;
    double step;
    const double *row_scale;
} Sight;

/* fmax and fmin are calls, for the sake of NaN */
INLINE double larger(double a, double b) { return a > b ? a : b; }

INLINE double smaller(double a, double b) { return a < b ? a : b; }

/* The platform's motion as polynomials of its own time, and the generated dynamics that evaluate it. */
typedef struct {
    int (*terms)(const double *numbers, int samples, const double *in, int width, double *near, double *out, double *sizes);
    const double *numbers;
    double *near;                  /* configurations that it goes on from */
    const double *edge, *piece;    /* x (PLACES), its rates and second rates (N): (order, pieces, PLACES + 2 N), the highest power first */
    long pieces, order;
    double moves_until;            /* the platform is held from then on */
    Evaluate *otherwise;            /* who is asked where the generated code does not close; 0: nobody */
    void *context;
} Polynomials;

/* x, its rates and second rates (PLACES + 2 N) at a time of the preview's own. */
static void platform_at(const Polynomials *p, double sigma, double *x) {
    enum { COLUMNS = PLACES + 2 * N };
    double at = sigma < p->moves_until ? sigma : p->moves_until;
    long low = 0, high = p->pieces;
    while (high - low > 1) {
        long middle = (low + high) / 2;
        if (p->edge[middle] <= at) low = middle; else high = middle;
    }
    at = at > p->edge[0] ? (at < p->edge[p->pieces] ? at : p->edge[p->pieces]) - p->edge[low] : 0.0;
    for (int c = 0; c < COLUMNS; c++) {
        x[c] = 0.0;
        for (long d = 0; d < p->order; d++) x[c] = x[c] * at + p->piece[(d * p->pieces + low) * COLUMNS + c];
    }
    if (sigma >= p->moves_until) memset(x + PLACES, 0, 2 * N * sizeof *x);
}

static long evaluate_polynomials(void *context, long count, const double *t, const double *sigma, const double *rate, const double *bend,
                                 double *out) {
    enum { WIDTH = 1 + PLACES + 2 * N };
    const Polynomials *p = context;
    double in[BATCH * WIDTH], sizes[2 * BATCH];
    for (long k = 0; k < count; k++) {
        double *xd = in + k * WIDTH + 1 + PLACES, *xdd = xd + N;
        in[k * WIDTH] = t[k];
        platform_at(p, sigma[k], in + k * WIDTH + 1);
        for (int c = 0; c < N; c++) xdd[c] = xdd[c] * rate[k] * rate[k] + xd[c] * bend[k], xd[c] *= rate[k];
        for (int c = 1; c < WIDTH; c++)
            if (!isfinite(in[k * WIDTH + c])) return -1;
    }
    long closed = p->terms(p->numbers, (int)count, in, WIDTH, p->near, out, sizes);
    return closed < count && p->otherwise ? p->otherwise(p->context, count, t, sigma, rate, bend, out) : closed;
}

/* --- the preview's time -------------------------------------------------------------------------------------------- */

static void sigma_at(const Scaling *z, double t, double *sigma, double *rate, double *bend) {
    *sigma = t, *rate = 1.0, *bend = 0.0;
    if (!z->pieces) return;
    double inside = larger(t, z->edge[0]), early = smaller(t - z->edge[0], 0.0);
    long i = 0;
    while (i < z->pieces - 1 && z->edge[i + 1] <= inside) i++;
    double x = inside - z->edge[i], value = 0.0, first = 0.0, half = 0.0;
    for (int d = 0; d < 5; d++) half = half * x + first, first = first * x + value, value = value * x + z->c[i][d];
    *sigma = value + first * early, *rate = first, *bend = early < 0.0 ? 0.0 : 2.0 * half;
}

static double final_rate(const Scaling *z) { return z->pieces ? z->c[z->pieces - 1][3] : 1.0; }

/* When sigma is reached; infinite where it never is. */
static double clock_at(const Scaling *z, double sigma) {
    double first, settled, rate, unused;
    if (!z->pieces) return sigma;
    double low = z->edge[0], high = z->edge[z->pieces - 1];
    sigma_at(z, low, &first, &rate, &unused);
    sigma_at(z, high, &settled, &unused, &unused);
    if (first < sigma && sigma <= settled) {
        for (double middle = 0.5 * (low + high); middle > low && middle < high; middle = 0.5 * (low + high)) {
            double value, by;
            sigma_at(z, middle, &value, &by, &unused);
            if (value < sigma) low = middle; else high = middle;
        }
        return high;
    }
    double place = sigma <= first ? low : high, reached = sigma <= first ? first : settled;
    if (sigma > first) rate = final_rate(z);
    return rate > 0.0 ? place + (sigma - reached) / rate : copysign(INFINITY, sigma - reached);
}

/* Polynomials of `order` coefficients, the highest first and `stride` numbers apart, in powers of the time from `by` later on. */
static void shift(double *c, int order, long stride, double by) {
    for (int last = order; last > 1; last--)
        for (int d = 1; d < last; d++) c[d * stride] += by * c[(d - 1) * stride];
}

/* The same up to a time, after which the rate, cubic in between, goes over to another one within a duration; what is before `since`
   is forgotten. */
static void change_rate(const Scaling *z, double t, double rate, double duration, double since, Scaling *to) {
    double sigma, v, a, h = duration;
    sigma_at(z, t, &sigma, &v, &a);
    to->pieces = 0;
    if (z->pieces) {
        double begin = smaller(larger(z->edge[0], since), t);
        long first = 0, last = 0;
        while (first < z->pieces - 1 && z->edge[first + 1] <= begin) first++;
        while (last < z->pieces - 1 && z->edge[last + 1] < t) last++;
        if (last - first > CURVE - 3) first = last - (CURVE - 3), begin = z->edge[first];   /* very many changes: the oldest are forgotten */
        for (long i = first; i <= last && begin < t; i++) {
            to->edge[to->pieces] = i > first ? z->edge[i] : begin;
            memcpy(to->c[to->pieces], z->c[i], sizeof z->c[i]);
            if (i == first) shift(to->c[0], 5, 1, begin - z->edge[i]);
            to->pieces++;
        }
    }
    /* v + a u + c u^2 + d u^3, at u = h the new rate, its derivative zero there */
    double by = rate - v, c = 3.0 * by / (h * h) - 2.0 * a / h, d = a / (h * h) - 2.0 * by / (h * h * h);
    const double ramp[5] = {d / 4.0, c / 3.0, a / 2.0, v, sigma};
    const double after[5] = {0.0, 0.0, 0.0, rate, sigma + h * (v + h * (a / 2.0 + h * (c / 3.0 + h * d / 4.0)))};
    memcpy(to->c[to->pieces], ramp, sizeof ramp), memcpy(to->c[to->pieces + 1], after, sizeof after);
    to->edge[to->pieces] = t, to->edge[to->pieces + 1] = t + h, to->edge[to->pieces + 2] = t + h + NO_END;
    to->pieces += 2;
}

/* The least and the largest rate of the last change. */
static void rates_of(const Scaling *z, double *least, double *most) {
    const double *c = z->c[z->pieces - 2];
    double h = z->edge[z->pieces - 1] - z->edge[z->pieces - 2], a = 12.0 * c[0], b = 6.0 * c[1], e = 2.0 * c[2], time[4] = {0.0, h, 0.0, h};
    double inside = b * b - 4.0 * a * e;
    if (a != 0.0 && inside >= 0.0) time[2] = (-b - sqrt(inside)) / (2.0 * a), time[3] = (-b + sqrt(inside)) / (2.0 * a);
    else if (a == 0.0 && b != 0.0) time[2] = -e / b;
    *least = INFINITY, *most = -INFINITY;
    for (int i = 0; i < 4; i++) {
        double x = smaller(larger(time[i], 0.0), h), rate = ((4.0 * c[0] * x + 3.0 * c[1]) * x + 2.0 * c[2]) * x + c[3];
        *least = smaller(*least, rate), *most = larger(*most, rate);
    }
}

/* The preview's time at a time of the clock, not before its start: an update may be earlier by rounding. */
static void seen_at(const Sight *v, double t, double *sigma, double *rate, double *bend) {
    sigma_at(v->scaling, t, sigma, rate, bend);
    *sigma = larger(*sigma, v->preview->start);
}

/* --- instants ------------------------------------------------------------------------------------------------------ */

/* Forget all but the instants before a time around which the nodes stay. */
static void clear(Window *w, double keep, double step) {
    long roots = 0, sharps = 0;
    for (long i = 0; i < w->roots; i++)
        if (w->root[i] < keep && w->root[i] >= keep - KEPT * step) w->root[roots++] = w->root[i];
    for (long i = 0; i < w->sharps; i++)   /* the first that is looked for is a step and up to two instants later */
        if (w->sharp[i] < keep + 1.3 * step && w->sharp[i] >= keep - KEPT * step) w->sharp[sharps++] = w->sharp[i];
    w->roots = roots, w->sharps = sharps;
    w->count = w->looked = w->determinants = w->recents = w->bends = 0;
    w->blocked = INFINITY;
    for (w->frees = 0; w->frees < CAPACITY; w->frees++) w->free[w->frees] = (int)(CAPACITY - 1 - w->frees);
}

/* A window of another motion from a time on: nothing is in sight yet, but what is past and the sizes. */
static void begin_window(Window *w, const Window *before, double t, double step) {
    w->roots = before->roots, w->sharps = before->sharps, w->largest = before->largest, w->size = before->size;
    memcpy(w->root, before->root, sizeof w->root);
    memcpy(w->sharp, before->sharp, sizeof w->sharp);
    clear(w, t, step);
}

/* Forget what is before a time. */
static void drop_before(Window *w, double past) {
    long gone = 0, roots = 0, sharps = 0;
    while (gone < w->count && w->t[gone] < past) w->free[w->frees++] = w->slot[gone++];
    w->count -= gone;
    memmove(w->t, w->t + gone, (size_t)w->count * sizeof *w->t);
    memmove(w->slot, w->slot + gone, (size_t)w->count * sizeof *w->slot);
    for (long i = 0; i < w->roots; i++)
        if (w->root[i] >= past) w->root[roots++] = w->root[i];
    for (long i = 0; i < w->sharps; i++)
        if (w->sharp[i] >= past) w->sharp[sharps++] = w->sharp[i];
    w->roots = roots, w->sharps = sharps, w->begin = larger(w->begin, past);
}

/* Where an instant is in the arrays; -1 where it is not. */
static int found(const Window *w, double time) {
    long low = 0, high = w->count;
    while (low < high) {
        long middle = (low + high) / 2;
        if (w->t[middle] < time - SAME) low = middle + 1; else high = middle;
    }
    return low < w->count && w->t[low] <= time + SAME ? w->slot[low] : -1;
}

/* Evaluate increasing instants of which none is there; 0 where the update is to end. */
static int add_instants(const Sight *v, const double *t, long count) {
    Window *w = v->window;
    for (long part; count > 0; t += part, count -= part) {
        double sigma[BATCH], rate[BATCH], bend[BATCH];
        long can = 0, there = 0;
        part = count < BATCH ? count : BATCH;
        for (; can < part && t[can] <= w->blocked; can++) seen_at(v, t[can], sigma + can, rate + can, bend + can);
        if (can) there = v->preview->evaluate(v->preview->context, can, t, sigma, rate, bend, w->some);
        if (there < 0 || w->frees < part) return 0;
        if (there < part) w->blocked = smaller(w->blocked, t[there]);
        const double *constant = w->some + can * N * M, *terms = constant + can * SUM;
        for (long i = 0; i < part; i++) {
            int slot = w->free[--w->frees];
            long place = w->count++;
            for (; place > 0 && w->t[place - 1] > t[i]; place--) w->t[place] = w->t[place - 1], w->slot[place] = w->slot[place - 1];
            w->t[place] = t[i], w->slot[place] = slot, w->reachable[slot] = i < there;
            if (i < there) {
                memcpy(w->W[slot], w->some + i * N * M, sizeof w->W[slot]);
                memcpy(w->constant[slot], constant + i * SUM, sizeof w->constant[slot]);
                memcpy(w->terms[slot], terms + i * ALL, sizeof w->terms[slot]);
            } else {
                memset(w->W[slot], 0, sizeof w->W[slot]);
                memset(w->constant[slot], 0, sizeof w->constant[slot]);
                memset(w->terms[slot], 0, sizeof w->terms[slot]);
            }
        }
    }
    return 1;
}

/* Evaluate those of some instants that are not there yet. */
static int ensure(const Sight *v, const double *t, long count) {
    double missing[WANTED];
    long many = 0;
    for (long i = 0; i < count; i++) {
        if (found(v->window, t[i]) >= 0) continue;
        long place = many;
        while (place > 0 && missing[place - 1] >= t[i]) place--;
        if (place < many && missing[place] == t[i]) continue;
        memmove(missing + place + 1, missing + place, (size_t)(many++ - place) * sizeof *missing);
        missing[place] = t[i];
    }
    return add_instants(v, missing, many);
}

/* --- singular instants --------------------------------------------------------------------------------------------- */

/* det W, by elimination with pivots; M is N. */
static double determinant_of(const double *W) {
    double A[N * M], result = 1.0;
    memcpy(A, W, sizeof A);
    for (int p = 0; p < N; p++) {
        int best = p;
        for (int i = p + 1; i < N; i++)
            if (fabs(A[i * M + p]) > fabs(A[best * M + p])) best = i;
        if (best != p) {
            result = -result;
            for (int j = 0; j < M; j++) { double x = A[p * M + j]; A[p * M + j] = A[best * M + j], A[best * M + j] = x; }
        }
        result *= A[p * M + p];
        if (A[p * M + p] == 0.0) return 0.0;
        for (int i = p + 1; i < N; i++)
            for (int j = p + 1; j < M; j++) A[i * M + j] -= A[i * M + p] / A[p * M + p] * A[p * M + j];
    }
    return result;
}

/* A Chebyshev series at x, from -1 to 1: Clenshaw's recurrence. */
static double chebyshev(const double *c, int count, double x) {
    double one = 0.0, two = 0.0;
    for (int k = count - 1; k > 0; k--) { double next = c[k] + 2.0 * x * one - two; two = one, one = next; }
    return c[0] + x * one - two;
}

/* Zeros from -1 to 1 of a Chebyshev series of size one, or lows that all but touch zero; their number.

   Between two neighbouring zeros of its derivative, or the ends, a function has at most one: so from the last derivative, which is
   a line, up to the series itself. */
static int zeros_of(const double *series, int count, double *zero) {
    double of[POINTS][POINTS], place[POINTS + 2], next[POINTS + 2];
    int places = 0, many = 0;
    while (count > 1 && fabs(series[count - 1]) <= ROUNDING) count--;
    memcpy(of[0], series, (size_t)count * sizeof *series);
    for (int d = 1; d < count; d++)
        for (int k = count - d - 1; k >= 0; k--) {   /* c'_k = c'_{k+2} + 2 (k + 1) c_{k+1}, of c'_0 half */
            double beyond = k + 2 < count - d ? of[d][k + 2] : 0.0;
            of[d][k] = (beyond + 2.0 * (k + 1) * of[d - 1][k + 1]) * (k ? 1.0 : 0.5);
        }
    for (int d = count - 2; d >= 0; d--) {
        const double *c = of[d];
        int length = count - d;
        double before = -1.0, value = chebyshev(c, length, -1.0), none = d ? 0.0 : ROOTED;
        many = 0;
        if (fabs(value) <= none) next[many++] = -1.0;
        for (int i = 0; i <= places; i++) {
            double x = i < places ? place[i] : 1.0, here = chebyshev(c, length, x);
            if (fabs(here) <= none) {
                next[many++] = x;
            } else if (value * here < 0.0 && fabs(value) > none) {
                double low = before, high = x;
                for (double middle = 0.5 * (low + high); middle > low && middle < high; middle = 0.5 * (low + high))
                    if (chebyshev(c, length, middle) * value > 0.0) low = middle; else high = middle;
                next[many++] = high;
            }
            before = x, value = here;
        }
        if (d) memcpy(place, next, sizeof place), places = many;
    }
    if (!many)
        for (int i = 0; i < places; i++)
            if (fabs(chebyshev(series, count, place[i])) < TOUCH) next[many++] = place[i];
    memcpy(zero, next, (size_t)many * sizeof *zero);
    return many;
}

/* Instants between two times at which det W is zero, or next to it at a dip; their number, or -1 where the update is to end. */
static int zeros_within(const Sight *v, double start, double end, double *zero) {
    Window *w = v->window;
    double middle = 0.5 * (start + end), half = 0.5 * (end - start), x[POINTS], t[POINTS], sigma[POINTS], rate[POINTS], bend[POINTS], series[POINTS];
    double least = INFINITY, most = 0.0, low = INFINITY, high = -INFINITY;
    for (int i = 0; i < POINTS; i++) {
        x[i] = -cos(PI * (i + 0.5) / POINTS), t[i] = middle + half * x[i];
        seen_at(v, t[i], sigma + i, rate + i, bend + i);
    }
    long there = v->preview->evaluate(v->preview->context, POINTS, t, sigma, rate, bend, w->some);
    if (there < POINTS) return there < 0 ? -1 : 0;
    memset(series, 0, sizeof series);
    for (int i = 0; i < POINTS; i++) {
        double value = determinant_of(w->some + i * N * M) / w->largest, before = 1.0, now = x[i];
        least = smaller(least, fabs(value)), most = larger(most, fabs(value)), low = smaller(low, value), high = larger(high, value);
        series[0] += value / POINTS;
        for (int k = 1; k < POINTS; k++) {
            series[k] += 2.0 * value / POINTS * now;
            double next = 2.0 * x[i] * now - before;
            before = now, now = next;
        }
    }
    if (least > larger(SHALLOW * most, 10.0 * TOUCH) && (low > 0.0 || high < 0.0)) return 0;
    int many = zeros_of(series, POINTS, zero);
    for (int i = 0; i < many; i++) zero[i] = middle + half * zero[i];
    return many;
}

/* Look for singular instants among further instants of the grid and the two before them; 0 where the update is to end. */
static int scan(const Sight *v, const double *time, long count, double *crossed, int *crossings) {
    Window *w = v->window;
    double value[GRID + 2], edge[GRID + 2], size[GRID + 2], zero[POINTS + 2];
    long many = w->determinants;
    memcpy(value, w->determinant, sizeof w->determinant), memcpy(edge, w->edge, sizeof w->edge);
    for (long i = 0; i < count; i++, many++) {
        int slot = found(w, time[i]);
        edge[many] = time[i], value[many] = w->reachable[slot] ? determinant_of(w->W[slot]) : NAN;   /* comparisons with NaN are false */
        if (fabs(value[many]) > w->largest) w->largest = fabs(value[many]);
    }
    for (long j = 0; j < many; j++) size[j] = fabs(value[j]);
    double none = AT_REST * w->largest;
    for (long j = 0; j < many; j++)
        for (int wide = 0; wide < 2; wide++) {
            long end = j + 1 + wide;
            if (end >= many || (end < w->determinants)) continue;
            int is_zero = size[j + 1] <= none;
            if (!wide && !(value[j] * value[end] < 0.0 && !(size[j] <= none) && !is_zero)) continue;
            int dip = wide && size[j + 1] <= size[j] && size[j + 1] < size[end] && size[j + 1] < 0.3 * w->largest;
            if (wide && !(dip && value[j] * value[end] > 0.0) && !(is_zero && !(size[j] <= none) && !(size[end] <= none))) continue;
            int zeros = zeros_within(v, edge[j], edge[end], zero);
            if (zeros < 0) return 0;
            for (int i = 0; i < zeros; i++) {
                int known = 0;
                for (long r = 0; r < w->roots; r++) known |= fabs(w->root[r] - zero[i]) < 1e-3 * v->step;
                if (known) continue;
                if (w->roots == MOST_ROOTS) {   /* no plan leads past it */
                    w->blocked = smaller(w->blocked, zero[i]);
                    continue;
                }
                long place = w->roots++;
                for (; place > 0 && w->root[place - 1] > zero[i]; place--) w->root[place] = w->root[place - 1];
                w->root[place] = zero[i], crossed[(*crossings)++] = zero[i];
            }
        }
    w->determinants = many < 2 ? many : 2;
    for (long i = 0; i < w->determinants; i++) w->determinant[i] = value[many - w->determinants + i], w->edge[i] = edge[many - w->determinants + i];
    return 1;
}

/* Look for instants a step or more before further ones where f of the parked machine bends most. */
static void scan_sharp(const Sight *v, const double *time, long count) {
    Window *w = v->window;
    double fades = pow(0.5, v->step / PARTS / FADES);
    for (long i = 0; i < count; i++) {
        int slot = found(w, time[i]);
        if (!w->reachable[slot]) {
            w->recents = w->bends = 0;
            continue;
        }
        if (w->recents == 2 * PARTS + 1) {
            memmove(w->recent_time, w->recent_time + 1, 2 * PARTS * sizeof *w->recent_time);
            memmove(w->recent, w->recent + 1, 2 * PARTS * sizeof *w->recent);
            w->recents--;
        }
        w->size *= fades;
        w->recent_time[w->recents] = time[i];
        for (int r = 0; r < N; r++) {
            w->recent[w->recents][r] = w->constant[slot][r] / v->row_scale[r];
            w->size = larger(w->size, fabs(w->recent[w->recents][r]));
        }
        if (++w->recents <= 2 * PARTS) continue;
        double middle = w->recent_time[PARTS], bend = 0.0;
        if (fabs(w->recent_time[0] + time[i] - 2.0 * middle) > SAME) {   /* a first or last one between the grid */
            w->bends = 0;
            continue;
        }
        for (int r = 0; r < N; r++) bend = larger(bend, fabs(w->recent[PARTS][r] - 0.5 * (w->recent[0][r] + w->recent[2 * PARTS][r])));
        if (w->bends == 3) {
            memmove(w->bend, w->bend + 1, 2 * sizeof *w->bend), memmove(w->bend_time, w->bend_time + 1, 2 * sizeof *w->bend);
            w->bends--;
        }
        w->bend_time[w->bends] = middle, w->bend[w->bends++] = bend;
        if (w->bends < 3 || !(w->bend[0] < w->bend[1] && w->bend[1] >= bend && w->bend[1] > SHARP * w->size)) continue;
        int known = 0;   /* with another preview it may be there already */
        for (long s = 0; s < w->sharps; s++) known |= fabs(w->sharp[s] - w->bend_time[1]) < 0.5 * v->step;
        if (known) continue;
        if (w->sharps == MOST_ROOTS) memmove(w->sharp, w->sharp + 1, (size_t)--w->sharps * sizeof *w->sharp);
        w->sharp[w->sharps++] = w->bend_time[1];
    }
}

/* Go on to a time, from a first one; at most the horizon ahead. 0 where the update is to end. */
static int look(const Sight *v, double start, double end) {
    Window *w = v->window;
    double spacing = v->step / PARTS, times[GRID], crossed[MOST_ROOTS], beside[3 * MOST_ROOTS];
    double ends = clock_at(v->scaling, v->preview->end);
    end = smaller(smaller(end, ends), start + v->step * (STEPS + 0.5));
    int in_sight = !w->looked || (w->begin <= start && start <= smaller(w->last, w->blocked) + SAME);
    if (v->preview->changing || !in_sight) clear(w, v->preview->changing ? start : -INFINITY, v->step);
    if (w->frees < GRID + BESIDE_GRID) drop_before(w, start - KEPT * v->step);
    if (w->frees < GRID + BESIDE_GRID) clear(w, start, v->step);   /* very many updates within few steps */
    double first = w->looked ? w->last : start;
    long count = 0;
    int crossings = 0;
    if (!w->looked) times[count++] = first;
    double i = floor(first / spacing);
    while (i * spacing <= first + 0.1 * spacing) i++;
    for (; i <= floor(end / spacing + 1e-6) && count < GRID - 1; i++) times[count++] = spacing * i;
    if (ends - end <= SAME && (!count || times[count - 1] < end - SAME) && end > first + SAME) times[count++] = end;   /* nothing more will be known */
    if (!count) return 1;
    if (!ensure(v, times, count)) return 0;
    if (!w->looked) w->begin = times[0];
    if (N == M && !scan(v, times, count, crossed, &crossings)) return 0;
    scan_sharp(v, times, count);
    w->looked = 1, w->last = times[count - 1];
    /* what plans ask for at singular instants, so that they need not come back for it */
    count = 0;
    for (int c = 0; c < crossings; c++)
        for (int side = -1; side < 2; side++) {
            double time = crossed[c] + side * DIFFERENCE;
            if (start <= time && time <= end) beside[count++] = time;
        }
    return ensure(v, beside, count);
}

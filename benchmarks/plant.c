/* The drive by fixed-step RK4, closed loop included: what `plant.py` measures against.

   Written for speed as one would write it for one drive: contact law and friction are chosen outside the loop, so that
   the compiler makes one loop for each. `exact_loop` is the reference: it finds where the equations change. */
#include <math.h>

typedef struct {
    double R, L, Km, Jm, Bm, R1, R2, half, Jl, Bl, rub_m, rub_l, limit;
    double c0, c1; /* beta and alpha, or stiffness and damping */
    int n;         /* exponent of the power law; 0: elastic */
} Drive;

static inline double whole_power(double b, int e) {
    double r = 1;
    while (e > 0) {
        if (e & 1) r *= b;
        b *= b;
        e >>= 1;
    }
    return r;
}

static inline double contact(const Drive *p, const double *y, int elastic) {
    double gap = p->R1 * y[0] - p->R2 * y[2], rate = p->R1 * y[1] - p->R2 * y[3];
    if (!elastic) {
        double s = gap / p->half, at = whole_power(s, p->n);
        return p->c0 * at + p->c1 * rate * at * s;
    }
    double depth = fabs(gap) - p->half;
    if (depth <= 0) return 0;
    double side = gap > 0 ? 1 : -1, spring = p->c0 * depth, damper = p->c1 * rate * side;
    if (damper > spring) damper = spring;
    if (damper < -spring) damper = -spring;
    return side * (spring + damper);
}

static inline void slope(const Drive *p, const double *y, double V, double sm, double sl, double *d, int elastic,
                         int rubs) {
    double F = contact(p, y, elastic);
    double on_m = p->Km * y[4] - p->Bm * y[1] - p->R1 * F, on_l = p->R2 * F - p->Bl * y[3];
    if (rubs) {
        on_m = sm == 0 ? 0 : on_m - sm * p->rub_m;
        on_l = sl == 0 ? 0 : on_l - sl * p->rub_l;
    }
    d[0] = y[1];
    d[1] = on_m / p->Jm;
    d[2] = y[3];
    d[3] = on_l / p->Jl;
    d[4] = (V - p->R * y[4] - p->Km * y[1]) / p->L;
}

/* The way a shaft slides: as it turns, or, at rest, where more acts on it than friction holds. */
static inline double slip(double speed, double torque, double rub) {
    if (speed != 0) return speed > 0 ? 1 : -1;
    return torque > rub ? 1 : torque < -rub ? -1 : 0;
}

/* What the equations are made of at y, a number for each: the side of the gap and the clamp of the damper. */
static inline int piece(const Drive *p, const double *y, int elastic) {
    double gap = p->R1 * y[0] - p->R2 * y[2], rate = p->R1 * y[1] - p->R2 * y[3], depth = fabs(gap) - p->half;
    if (!elastic || depth <= 0) return 0;
    double side = gap > 0 ? 1 : -1, spring = p->c0 * depth, damper = p->c1 * rate * side;
    return side * (damper > spring ? 3 : damper < -spring ? 1 : 2);
}

static inline double voltage(const Drive *p, const double *gains, double feed, const double *y) {
    double V = feed - gains[0] * y[2] - gains[1] * y[3] - gains[2] * y[4];
    return V > p->limit ? p->limit : V < -p->limit ? -p->limit : V;
}

static inline void slips(const Drive *p, const double *y, double *sm, double *sl, int elastic) {
    double F = contact(p, y, elastic);
    *sm = slip(y[1], p->Km * y[4] - p->R1 * F, p->rub_m);
    *sl = slip(y[3], p->R2 * F, p->rub_l);
}

/* By how much a step changes y. */
static inline void rise(const Drive *p, const double *y, double V, double h, double sm, double sl, double *out,
                        int elastic, int rubs) {
    double a[5], b[5], c[5], d[5], t[5];
    slope(p, y, V, sm, sl, a, elastic, rubs);
    for (int i = 0; i < 5; i++) t[i] = y[i] + 0.5 * h * a[i];
    slope(p, t, V, sm, sl, b, elastic, rubs);
    for (int i = 0; i < 5; i++) t[i] = y[i] + 0.5 * h * b[i];
    slope(p, t, V, sm, sl, c, elastic, rubs);
    for (int i = 0; i < 5; i++) t[i] = y[i] + h * c[i];
    slope(p, t, V, sm, sl, d, elastic, rubs);
    for (int i = 0; i < 5; i++) out[i] = h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]);
}

static inline void play(const Drive *pp, const double *gains, const double *feed, int count, double T, int sub,
                        double *state, double *out, int elastic, int rubs) {
    Drive q = *pp;
    const Drive *p = &q;
    double y[5], more[5], h = T / sub, sm = 1, sl = 1;
    for (int i = 0; i < 5; i++) y[i] = state[i];
    for (int k = 0; k < count; k++) {
        double V = voltage(p, gains, feed[k], y);
        for (int s = 0; s < sub; s++) {
            if (rubs) slips(p, y, &sm, &sl, elastic);
            rise(p, y, V, h, sm, sl, more, elastic, rubs);
            for (int i = 0; i < 5; i++) y[i] += more[i];
            if (rubs) { /* stop at a reversal */
                if (y[1] * sm < 0) y[1] = 0;
                if (y[3] * sl < 0) y[3] = 0;
            }
        }
        out[k] = y[2];
    }
    for (int i = 0; i < 5; i++) state[i] = y[i];
}

void loop(const Drive *p, const double *gains, const double *feed, int count, double T, int sub, double *state,
          double *out) {
    int rubs = p->rub_m > 0 || p->rub_l > 0;
    if (p->n > 0 && !rubs) play(p, gains, feed, count, T, sub, state, out, 0, 0);
    else if (p->n > 0) play(p, gains, feed, count, T, sub, state, out, 0, 1);
    else if (!rubs) play(p, gains, feed, count, T, sub, state, out, 1, 0);
    else play(p, gains, feed, count, T, sub, state, out, 1, 1);
}

#define PARTS 1024 /* of a step, down to which it is halved where the equations change */

/* The same without its errors: a step is halved again and again where the contact or the slip of a shaft changes in it,
   and what the steps add up to is kept with more digits. */
void exact_loop(const Drive *p, const double *gains, const double *feed, int count, double T, int sub, double *state,
                double *out) {
    int elastic = p->n == 0, rubs = p->rub_m > 0 || p->rub_l > 0;
    double y[5], t[5], more[5], h = T / sub / PARTS, sm = 1, sl = 1, next_m = 1, next_l = 1;
    long double sum[5];
    for (int i = 0; i < 5; i++) sum[i] = y[i] = state[i];
    for (int k = 0; k < count; k++) {
        double V = voltage(p, gains, feed[k], y);
        long size = PARTS;
        for (long at = 0; at < (long)sub * PARTS; at += size) {
            while (size < PARTS && at % (2 * size) == 0) size *= 2;
            int was = piece(p, y, elastic), changed;
            if (rubs) slips(p, y, &sm, &sl, elastic);
            for (;; size /= 2) {
                rise(p, y, V, h * size, sm, sl, more, elastic, rubs);
                for (int i = 0; i < 5; i++) t[i] = y[i] + more[i];
                if (rubs) slips(p, t, &next_m, &next_l, elastic);
                changed = piece(p, t, elastic) != was || (rubs && (next_m != sm || next_l != sl));
                if (!changed || size == 1) break;
            }
            for (int i = 0; i < 5; i++) sum[i] += more[i];
            if (rubs && sum[1] * sm < 0) sum[1] = 0;
            if (rubs && sum[3] * sl < 0) sum[3] = 0;
            for (int i = 0; i < 5; i++) y[i] = (double)sum[i];
        }
        out[k] = y[2];
    }
    for (int i = 0; i < 5; i++) state[i] = y[i];
}

/* ---------------------------------------------------------------------------------------------------------------
 * From here on the text is the same for every vehicle.
 * ------------------------------------------------------------------------------------------------------------- */

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math and -ffinite-math-only: faults are recognised by NaN and infinity"
#endif

#define CALIB_TWO_PI 6.283185307179586476925286766559
/* way that a radian of turning counts as in the random walk */
#define CALIB_WAY_PER_RAD_M 0.1

typedef enum {
    CALIB_OK = 0,
    CALIB_NO_LOAD = 1,           /* no valid wheel loads are set */
    CALIB_LOAD_OUT_OF_RANGE = 2, /* outside the range in which the law holds */
    CALIB_NOT_FINITE = 3,        /* a value is NaN or infinite */
    CALIB_JUMP = 4,              /* counts moved further than a plausible step */
    CALIB_STALE = 5,             /* too long since the last good sample */
    CALIB_TIME_BACKWARDS = 6,    /* time did not advance */
    CALIB_BAD_ARGUMENT = 7,      /* negative payload, or no such line of the load table */
    CALIB_WHEEL_LIFTS = 8,       /* a wheel would lift under this payload */
    CALIB_OVERLOAD = 9           /* a wheel would carry more than is permitted */
} calib_status;

/* ---- radius against load, double ---- */

/* Radius of a wheel in m at a load in N. Where the load is refused, *radius_m is left as it was. */
static inline calib_status calib_radius_left(double load_N, double *radius_m)
{
    if (!isfinite(load_N)) {
        return CALIB_NOT_FINITE;
    }
    if (load_N < CALIB_LEFT_LOAD_MIN_N || load_N > CALIB_LEFT_LOAD_MAX_N) {
        if (!CALIB_OUTSIDE_CLAMP || load_N <= 0.0 || load_N > CALIB_MAX_WHEEL_LOAD_N) {
            return CALIB_LOAD_OUT_OF_RANGE;
        }
        load_N = load_N < CALIB_LEFT_LOAD_MIN_N ? CALIB_LEFT_LOAD_MIN_N : CALIB_LEFT_LOAD_MAX_N;
    }
    *radius_m = CALIB_LEFT_RADIUS_REF_M + CALIB_LEFT_SLOPE_M_PER_N * (load_N - CALIB_LEFT_REFERENCE_LOAD_N);
    return CALIB_OK;
}

static inline calib_status calib_radius_right(double load_N, double *radius_m)
{
    if (!isfinite(load_N)) {
        return CALIB_NOT_FINITE;
    }
    if (load_N < CALIB_RIGHT_LOAD_MIN_N || load_N > CALIB_RIGHT_LOAD_MAX_N) {
        if (!CALIB_OUTSIDE_CLAMP || load_N <= 0.0 || load_N > CALIB_MAX_WHEEL_LOAD_N) {
            return CALIB_LOAD_OUT_OF_RANGE;
        }
        load_N = load_N < CALIB_RIGHT_LOAD_MIN_N ? CALIB_RIGHT_LOAD_MIN_N : CALIB_RIGHT_LOAD_MAX_N;
    }
    *radius_m = CALIB_RIGHT_RADIUS_REF_M + CALIB_RIGHT_SLOPE_M_PER_N * (load_N - CALIB_RIGHT_REFERENCE_LOAD_N);
    return CALIB_OK;
}

/* ---- radius against load, integers ---- */

/* Radius in nm at a load in mN, no floating point; within CALIB_*_MAX_ERROR_NM of the law. */
static inline calib_status calib_radius_left_nm(int32_t load_mN, int32_t *radius_nm)
{
    if (load_mN < CALIB_LEFT_LOAD_MIN_MN || load_mN > CALIB_LEFT_LOAD_MAX_MN) {
        if (!CALIB_OUTSIDE_CLAMP || load_mN <= 0 || load_mN > CALIB_MAX_WHEEL_LOAD_MN) {
            return CALIB_LOAD_OUT_OF_RANGE;
        }
        load_mN = load_mN < CALIB_LEFT_LOAD_MIN_MN ? CALIB_LEFT_LOAD_MIN_MN : CALIB_LEFT_LOAD_MAX_MN;
    }
    *radius_nm = (int32_t)((CALIB_LEFT_BASE_Q + CALIB_LEFT_SLOPE_Q * (int64_t)(load_mN - CALIB_LEFT_LOAD_MIN_MN)
                            + (INT64_C(1) << (CALIB_LEFT_SHIFT - 1)))
                           / (INT64_C(1) << CALIB_LEFT_SHIFT));
    return CALIB_OK;
}

static inline calib_status calib_radius_right_nm(int32_t load_mN, int32_t *radius_nm)
{
    if (load_mN < CALIB_RIGHT_LOAD_MIN_MN || load_mN > CALIB_RIGHT_LOAD_MAX_MN) {
        if (!CALIB_OUTSIDE_CLAMP || load_mN <= 0 || load_mN > CALIB_MAX_WHEEL_LOAD_MN) {
            return CALIB_LOAD_OUT_OF_RANGE;
        }
        load_mN = load_mN < CALIB_RIGHT_LOAD_MIN_MN ? CALIB_RIGHT_LOAD_MIN_MN : CALIB_RIGHT_LOAD_MAX_MN;
    }
    *radius_nm = (int32_t)((CALIB_RIGHT_BASE_Q + CALIB_RIGHT_SLOPE_Q * (int64_t)(load_mN - CALIB_RIGHT_LOAD_MIN_MN)
                            + (INT64_C(1) << (CALIB_RIGHT_SHIFT - 1)))
                           / (INT64_C(1) << CALIB_RIGHT_SHIFT));
    return CALIB_OK;
}

/* ---- odometry ----
 *
 * Step: with travels l, r of the wheels, s = (l + r)/2, d = (r - l)/track, m = theta + d/2:
 *   x += s sinc(d/2) cos m, y += s sinc(d/2) sin m, theta += d            (the exact arc)
 * Covariance: P = J C J' + R + Q. J: derivative of the pose by (radius_ref_l, slope_l, radius_ref_r, slope_r, track),
 * carried along the path; R: random walk of distance and heading; Q: one reading of each encoder, at both ends.
 * A refused sample changes nothing: the pose stays the last good one, the next sample is measured against the last
 * good counts. A fault lasts until a plausible sample, or until calib_rebase gives the motion in between up.
 */
typedef struct {
    double x_m, y_m, theta_rad, distance_m, t_s;
    double radius_left_m, radius_right_m, offset_left_N, offset_right_N;
    double jacobian[3][5];
    double random[6]; /* xx, xy, xt, yy, yt, tt */
    int64_t counts_left, counts_right;
    int has_load, has_counts, has_time, clamped, interrupted;
    calib_status load_status, status;
} calib_odometer;

typedef struct {
    double x_m, y_m, theta_rad;  /* theta is not wrapped */
    double covariance[3][3];     /* of x in m, y in m, theta in rad */
    double distance_m;           /* driven, back and forth both counted */
    double t_s;                  /* of the last good sample, where times are fed */
    int clamped;                 /* a load was outside the valid range and is clamped */
    int interrupted;             /* motion was given up since the last reset */
} calib_pose;

static inline calib_status calib_refuse_load_(calib_odometer *o, calib_status status)
{
    o->has_load = 0;
    o->clamped = 0;
    o->load_status = status;
    o->status = status;
    return status;
}

/* Start anew at a pose known exactly; wheel loads stay, the next sample is the first. */
static inline calib_status calib_reset(calib_odometer *o, double x_m, double y_m, double theta_rad)
{
    int i, j;
    if (!isfinite(x_m) || !isfinite(y_m) || !isfinite(theta_rad)) {
        return CALIB_NOT_FINITE;
    }
    o->x_m = x_m;
    o->y_m = y_m;
    o->theta_rad = theta_rad;
    o->distance_m = 0.0;
    o->t_s = 0.0;
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 5; ++j) {
            o->jacobian[i][j] = 0.0;
        }
    }
    for (i = 0; i < 6; ++i) {
        o->random[i] = 0.0;
    }
    o->counts_left = 0;
    o->counts_right = 0;
    o->has_counts = 0;
    o->has_time = 0;
    o->interrupted = 0;
    o->status = o->has_load ? CALIB_OK : o->load_status;
    return CALIB_OK;
}

/* Before anything else: no loads, pose (0, 0, 0). */
static inline void calib_init(calib_odometer *o)
{
    o->radius_left_m = 0.0;
    o->radius_right_m = 0.0;
    o->offset_left_N = 0.0;
    o->offset_right_N = 0.0;
    (void)calib_refuse_load_(o, CALIB_NO_LOAD);
    (void)calib_reset(o, 0.0, 0.0, 0.0);
}

/* Give up the motion since the last good sample: the next sample is a first one, the pose goes on. */
static inline void calib_rebase(calib_odometer *o)
{
    if (o->has_counts) {
        o->interrupted = 1;
    }
    o->has_counts = 0;
    o->has_time = 0;
}

/* Set the loads of the rear wheels in N. Where they are refused, samples are refused until valid loads are set. */
static inline calib_status calib_set_wheel_loads(calib_odometer *o, double left_N, double right_N)
{
    double radius_left = 0.0, radius_right = 0.0;
    double used_left = left_N, used_right = right_N;
    calib_status status_left = calib_radius_left(left_N, &radius_left);
    calib_status status_right = calib_radius_right(right_N, &radius_right);
    if (status_left == CALIB_NOT_FINITE || status_right == CALIB_NOT_FINITE) {
        return calib_refuse_load_(o, CALIB_NOT_FINITE);
    }
    if (status_left != CALIB_OK || status_right != CALIB_OK) {
        return calib_refuse_load_(o, CALIB_LOAD_OUT_OF_RANGE);
    }
    used_left = fmin(fmax(left_N, CALIB_LEFT_LOAD_MIN_N), CALIB_LEFT_LOAD_MAX_N);
    used_right = fmin(fmax(right_N, CALIB_RIGHT_LOAD_MIN_N), CALIB_RIGHT_LOAD_MAX_N);
    o->clamped = used_left < left_N || used_left > left_N || used_right < right_N || used_right > right_N;
    o->radius_left_m = radius_left;
    o->radius_right_m = radius_right;
    o->offset_left_N = used_left - CALIB_LEFT_REFERENCE_LOAD_N;
    o->offset_right_N = used_right - CALIB_RIGHT_REFERENCE_LOAD_N;
    o->has_load = 1;
    o->load_status = CALIB_OK;
    o->status = CALIB_OK;
    return CALIB_OK;
}

/* Set the wheel loads from a payload in kg and its centre of mass, ahead of the rear axle and left of the middle. */
static inline calib_status calib_set_payload(calib_odometer *o, double kg, double x_m, double y_m)
{
    double total, ahead, aside, left, right, front;
    if (!isfinite(kg) || !isfinite(x_m) || !isfinite(y_m)) {
        return calib_refuse_load_(o, CALIB_NOT_FINITE);
    }
    if (kg < 0.0) {
        return calib_refuse_load_(o, CALIB_BAD_ARGUMENT);
    }
    total = CALIB_MASS_KG + kg;
    ahead = (CALIB_MASS_KG * CALIB_COG_X_M + kg * x_m) / CALIB_LOAD_WHEELBASE_M;
    aside = (CALIB_MASS_KG * CALIB_COG_Y_M + kg * y_m) / CALIB_LOAD_TRACK_M;
    left = CALIB_GRAVITY_MPS2 * (0.5 * (total - ahead) + aside);
    right = CALIB_GRAVITY_MPS2 * (0.5 * (total - ahead) - aside);
    front = CALIB_GRAVITY_MPS2 * ahead;
    if (!(left > 0.0 && right > 0.0 && front > 0.0)) {
        return calib_refuse_load_(o, CALIB_WHEEL_LIFTS);
    }
    if (left > CALIB_MAX_WHEEL_LOAD_N || right > CALIB_MAX_WHEEL_LOAD_N || front > CALIB_MAX_WHEEL_LOAD_N) {
        return calib_refuse_load_(o, CALIB_OVERLOAD);
    }
    return calib_set_wheel_loads(o, left, right);
}

/* Set the wheel loads of a line of the load table, counted from 0. */
static inline calib_status calib_set_load_point(calib_odometer *o, unsigned index)
{
    double left = 0.0, right = 0.0;
    if (!calib_load_point(index, &left, &right)) {
        return calib_refuse_load_(o, CALIB_BAD_ARGUMENT);
    }
    return calib_set_wheel_loads(o, left, right);
}

/* Covariance (xx, xy, xt, yy, yt, tt) that one reading of each encoder adds at the pose. */
static inline void calib_reading_(const calib_odometer *o, double q[6])
{
    const double sl = CALIB_TWO_PI * o->radius_left_m / CALIB_COUNTS_PER_REV_LEFT * CALIB_COUNT_STD;
    const double sr = CALIB_TWO_PI * o->radius_right_m / CALIB_COUNTS_PER_REV_RIGHT * CALIB_COUNT_STD;
    const double along = 0.25 * (sl * sl + sr * sr);
    const double heading = (sl * sl + sr * sr) / (CALIB_TRACK_M * CALIB_TRACK_M);
    const double both = 0.5 * (sr * sr - sl * sl) / CALIB_TRACK_M;
    const double c = cos(o->theta_rad), s = sin(o->theta_rad);
    const double present = o->has_counts ? 1.0 : 0.0;
    q[0] = present * along * c * c;
    q[1] = present * along * c * s;
    q[2] = present * both * c;
    q[3] = present * along * s * s;
    q[4] = present * both * s;
    q[5] = present * heading;
}

/* Advance pose and covariance by the turns of the wheels in rad. */
static inline void calib_step_(calib_odometer *o, double turn_left, double turn_right)
{
    const double travel_left = turn_left * o->radius_left_m, travel_right = turn_right * o->radius_right_m;
    const double s = 0.5 * (travel_right + travel_left);
    const double d = (travel_right - travel_left) / CALIB_TRACK_M;
    const double u = 0.5 * d, v = u * u;
    const double m = o->theta_rad + u, c = cos(m), n = sin(m);
    const double way = fabs(s) + CALIB_WAY_PER_RAD_M * fabs(d);
    const double walk_s = CALIB_ALONG_M_PER_SQRT_M * CALIB_ALONG_M_PER_SQRT_M * way;
    const double walk_d = CALIB_HEADING_RAD_PER_SQRT_M * CALIB_HEADING_RAD_PER_SQRT_M * way;
    double sinc, slope, dx, dy, xs, ys, xd, yd;
    double rate_s[5], rate_d[5], old[6];
    int p;
    if (fabs(u) < 1e-2) { /* by series near zero, where the quotients lose their digits */
        sinc = 1.0 - v / 6.0 * (1.0 - v / 20.0 * (1.0 - v / 42.0));
        slope = -u / 3.0 * (1.0 - v / 10.0 * (1.0 - v / 28.0));
    } else {
        sinc = sin(u) / u;
        slope = (u * cos(u) - sin(u)) / v;
    }
    dx = s * sinc * c;
    dy = s * sinc * n;
    xs = sinc * c;
    ys = sinc * n;
    xd = 0.5 * s * slope * c - 0.5 * dy;
    yd = 0.5 * s * slope * n + 0.5 * dx;
    rate_s[0] = 0.5 * turn_left;
    rate_s[1] = rate_s[0] * o->offset_left_N;
    rate_s[2] = 0.5 * turn_right;
    rate_s[3] = rate_s[2] * o->offset_right_N;
    rate_s[4] = 0.0;
    rate_d[0] = -turn_left / CALIB_TRACK_M;
    rate_d[1] = rate_d[0] * o->offset_left_N;
    rate_d[2] = turn_right / CALIB_TRACK_M;
    rate_d[3] = rate_d[2] * o->offset_right_N;
    rate_d[4] = -d / CALIB_TRACK_M;
    for (p = 0; p < 5; ++p) {
        o->jacobian[0][p] += xs * rate_s[p] + xd * rate_d[p] - dy * o->jacobian[2][p];
        o->jacobian[1][p] += ys * rate_s[p] + yd * rate_d[p] + dx * o->jacobian[2][p];
        o->jacobian[2][p] += rate_d[p];
    }
    for (p = 0; p < 6; ++p) {
        old[p] = o->random[p];
    }
    o->random[0] = old[0] - 2.0 * dy * old[2] + dy * dy * old[5] + walk_s * xs * xs + walk_d * xd * xd;
    o->random[1] = old[1] + dx * old[2] - dy * old[4] - dx * dy * old[5] + walk_s * xs * ys + walk_d * xd * yd;
    o->random[2] = old[2] - dy * old[5] + walk_d * xd;
    o->random[3] = old[3] + 2.0 * dx * old[4] + dx * dx * old[5] + walk_s * ys * ys + walk_d * yd * yd;
    o->random[4] = old[4] + dx * old[5] + walk_d * yd;
    o->random[5] = old[5] + walk_d;
    o->x_m += dx;
    o->y_m += dy;
    o->theta_rad += d;
    o->distance_m += fabs(s);
}

/* Difference of two counter readings, wraps undone; NaN where it exceeds what a double holds exactly. */
static inline double calib_difference_(int64_t now, int64_t before)
{
#if CALIB_WRAP_BITS > 0
    const uint64_t span = UINT64_C(1) << CALIB_WRAP_BITS;
    const uint64_t delta = ((uint64_t)now - (uint64_t)before) & (span - 1);
    return delta >= span / 2 ? (double)delta - (double)span : (double)delta;
#else
    const double rough = (double)now - (double)before;
    if (!(fabs(rough) <= 9.0e15)) {
        return NAN;
    }
    return (double)(now - before);
#endif
}

static inline calib_status calib_feed_(calib_odometer *o, int64_t left, int64_t right, double t_s, int has_time)
{
    double turn_left, turn_right;
    int p;
    if (!o->has_load) {
        return o->load_status;
    }
    if (has_time && !isfinite(t_s)) {
        return CALIB_NOT_FINITE;
    }
    if (!o->has_counts) {
        double q[6];
        o->has_counts = 1;
        calib_reading_(o, q);
        for (p = 0; p < 6; ++p) {
            o->random[p] += q[p];
        }
    } else {
        if (has_time && o->has_time) {
            if (t_s <= o->t_s) {
                return CALIB_TIME_BACKWARDS;
            }
            if (t_s - o->t_s > CALIB_MAX_GAP_S) {
                return CALIB_STALE;
            }
        }
        turn_left = CALIB_TWO_PI * calib_difference_(left, o->counts_left) / CALIB_COUNTS_PER_REV_LEFT;
        turn_right = CALIB_TWO_PI * calib_difference_(right, o->counts_right) / CALIB_COUNTS_PER_REV_RIGHT;
        if (!(fabs(turn_left * o->radius_left_m) <= CALIB_MAX_STEP_M)
            || !(fabs(turn_right * o->radius_right_m) <= CALIB_MAX_STEP_M)) {
            return CALIB_JUMP;
        }
        calib_step_(o, turn_left, turn_right);
    }
    o->counts_left = left;
    o->counts_right = right;
    o->has_time = has_time;
    if (has_time) {
        o->t_s = t_s;
    }
    return CALIB_OK;
}

/* Feed the counters as read; gaps in time are not seen. */
static inline calib_status calib_feed(calib_odometer *o, int64_t counts_left, int64_t counts_right)
{
    o->status = calib_feed_(o, counts_left, counts_right, 0.0, 0);
    return o->status;
}

/* Feed the counters as read at a time in s; a silence longer than CALIB_MAX_GAP_S is a fault. */
static inline calib_status calib_feed_at(calib_odometer *o, int64_t counts_left, int64_t counts_right, double t_s)
{
    o->status = calib_feed_(o, counts_left, counts_right, t_s, 1);
    return o->status;
}

/* The last good pose and its covariance; returns the status of the last call. */
static inline calib_status calib_get_pose(const calib_odometer *o, calib_pose *pose)
{
#if CALIB_PREDICTION_BAND
    const double scatter_left = CALIB_LEFT_RESIDUAL_STD_M * CALIB_LEFT_RESIDUAL_STD_M;
    const double scatter_right = CALIB_RIGHT_RESIDUAL_STD_M * CALIB_RIGHT_RESIDUAL_STD_M;
    const double lr = CALIB_COV_02 + CALIB_RUN_COVARIANCE_M2;
#else
    const double scatter_left = 0.0, scatter_right = 0.0, lr = CALIB_COV_02;
#endif
    const double ll = CALIB_LEFT_VAR_RADIUS_REF_M2 + scatter_left;
    const double rr = CALIB_RIGHT_VAR_RADIUS_REF_M2 + scatter_right;
    const double bb = CALIB_TRACK_STD_M * CALIB_TRACK_STD_M;
    double q[6];
    int i, j, k = 0;
    calib_reading_(o, q);
    for (i = 0; i < 3; ++i) {
        for (j = i; j < 3; ++j, ++k) {
            const double *a = o->jacobian[i], *b = o->jacobian[j];
            const double part = a[0] * ll * b[0] + (a[0] * b[1] + a[1] * b[0]) * CALIB_LEFT_COV_M2_PER_N
                + a[1] * CALIB_LEFT_VAR_SLOPE_M2_PER_N2 * b[1] + a[2] * rr * b[2]
                + (a[2] * b[3] + a[3] * b[2]) * CALIB_RIGHT_COV_M2_PER_N
                + a[3] * CALIB_RIGHT_VAR_SLOPE_M2_PER_N2 * b[3] + a[4] * bb * b[4];
            const double between = (a[0] * b[2] + a[2] * b[0]) * lr
                + (a[0] * b[3] + a[3] * b[0]) * CALIB_COV_03 + (a[0] * b[4] + a[4] * b[0]) * CALIB_COV_04
                + (a[1] * b[2] + a[2] * b[1]) * CALIB_COV_12 + (a[1] * b[3] + a[3] * b[1]) * CALIB_COV_13
                + (a[1] * b[4] + a[4] * b[1]) * CALIB_COV_14 + (a[2] * b[4] + a[4] * b[2]) * CALIB_COV_24
                + (a[3] * b[4] + a[4] * b[3]) * CALIB_COV_34;
            pose->covariance[i][j] = part + between + o->random[k] + q[k];
            pose->covariance[j][i] = pose->covariance[i][j];
        }
    }
    pose->x_m = o->x_m;
    pose->y_m = o->y_m;
    pose->theta_rad = o->theta_rad;
    pose->distance_m = o->distance_m;
    pose->t_s = o->t_s;
    pose->clamped = o->clamped;
    pose->interrupted = o->interrupted;
    return o->status;
}

#ifdef __cplusplus
}
#endif

#endif /* CALIB_COEFFICIENTS_H */

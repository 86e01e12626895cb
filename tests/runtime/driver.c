/* Drives the header's odometry from a script on standard input, one call a line, and prints what became of it. */
#include <inttypes.h>
#include <stdio.h>

#include "calib_coefficients.h"

static void show(const calib_odometer *o, calib_status status)
{
    calib_pose p;
    calib_status last = calib_get_pose(o, &p);
    int i, j;
    printf("%d %d %d %d %.17g %.17g %.17g %.17g", (int)status, (int)last, p.clamped, p.interrupted, p.x_m, p.y_m,
           p.theta_rad, p.distance_m);
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j) {
            printf(" %.17g", p.covariance[i][j]);
        }
    }
    printf("\n");
}

int main(void)
{
    calib_odometer o;
    char what;
    int quiet = 0;
    calib_init(&o);
    while (scanf(" %c", &what) == 1) {
        calib_status status = CALIB_OK;
        double a, b, c;
        int64_t l, r;
        unsigned index;
        if (what == 'q') {
            quiet = 1;
            continue;
        }
        if (what == 's') {
            show(&o, status);
            continue;
        }
        if (what == 'L' && scanf("%lf %lf", &a, &b) == 2) {
            status = calib_set_wheel_loads(&o, a, b);
        } else if (what == 'P' && scanf("%lf %lf %lf", &a, &b, &c) == 3) {
            status = calib_set_payload(&o, a, b, c);
        } else if (what == 'I' && scanf("%u", &index) == 1) {
            status = calib_set_load_point(&o, index);
        } else if (what == 'F' && scanf("%" SCNd64 " %" SCNd64, &l, &r) == 2) {
            status = calib_feed(&o, l, r);
        } else if (what == 'T' && scanf("%" SCNd64 " %" SCNd64 " %lf", &l, &r, &a) == 3) {
            status = calib_feed_at(&o, l, r, a);
        } else if (what == 'B') {
            calib_rebase(&o);
        } else if (what == 'R' && scanf("%lf %lf %lf", &a, &b, &c) == 3) {
            status = calib_reset(&o, a, b, c);
        } else {
            return 3;
        }
        if (!quiet) {
            show(&o, status);
        }
    }
    return 0;
}

/* Replays a log through the header that `calib export --to c` writes, across dropouts.
 *
 *   calib export CAMPAIGN --to c --output .
 *   cc -std=c99 -O2 -I. replay.c -lm -o replay
 *   ./replay LOAD_LEFT_N LOAD_RIGHT_N < logs/r001.csv > path.csv
 *
 * The log has the columns t_s, counts_left, counts_right in any order; others are skipped. After a gap in time, or a
 * jump of a counter, the header refuses samples and the pose stays the last good one: calib_rebase then takes the next
 * sample as a new beginning. The motion in between is given up, the pose says `interrupted` from then on, and the
 * covariance does not hold it: bring the pose back by other means (a marker, a map) before it is trusted.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "calib_coefficients.h"

#define LONGEST_LINE 4096
#define COLUMNS 3

static const char *const NAMES[COLUMNS] = {"t_s", "counts_left", "counts_right"};

/* The cells of a line, cut in place; returns how many there are. */
static int cells_of(char *line, char *cells[], int most)
{
    int n = 0;
    char *at = line;
    line[strcspn(line, "\r\n")] = '\0';
    while (n < most) {
        cells[n++] = at;
        at = strchr(at, ',');
        if (at == NULL) {
            break;
        }
        *at++ = '\0';
    }
    return n;
}

/* The place of each column in the header line; 0 where one is missing. */
static int places_of(char *header, int places[COLUMNS])
{
    char *cells[256];
    int n = cells_of(header, cells, 256);
    int column, cell;
    for (column = 0; column < COLUMNS; ++column) {
        places[column] = -1;
        for (cell = 0; cell < n; ++cell) {
            if (strcmp(cells[cell], NAMES[column]) == 0) {
                places[column] = cell;
            }
        }
        if (places[column] < 0) {
            fprintf(stderr, "replay: found no column %s; expected one in the header line\n", NAMES[column]);
            return 0;
        }
    }
    return 1;
}

int main(int argc, char **argv)
{
    static char line[LONGEST_LINE];
    int places[COLUMNS];
    long row = 1, dropouts = 0;
    calib_odometer odometer;
    calib_init(&odometer);
    if (argc != 3 || calib_set_wheel_loads(&odometer, atof(argv[1]), atof(argv[2])) != CALIB_OK) {
        fprintf(stderr, "replay: found no wheel loads that were measured; expected LOAD_LEFT_N LOAD_RIGHT_N\n");
        return 2;
    }
    if (fgets(line, sizeof line, stdin) == NULL || !places_of(line, places)) {
        return 2;
    }
    printf("t_s,x_m,y_m,theta_rad\n");
    while (fgets(line, sizeof line, stdin) != NULL) {
        char *cells[256];
        int n = cells_of(line, cells, 256);
        calib_status status;
        calib_pose pose;
        double t_s;
        int64_t left, right;
        ++row;
        if (n <= places[0] || n <= places[1] || n <= places[2] || *cells[places[1]] == '\0' || *cells[places[2]] == '\0') {
            continue; /* a row without counts is part of a dropout */
        }
        t_s = atof(cells[places[0]]);
        left = (int64_t)strtoll(cells[places[1]], NULL, 10);
        right = (int64_t)strtoll(cells[places[2]], NULL, 10);
        status = calib_feed_at(&odometer, left, right, t_s);
        if (status == CALIB_STALE || status == CALIB_JUMP) {
            ++dropouts;
            fprintf(stderr, "replay: row %ld, %.3f s: a %s; the motion in between is given up\n", row, t_s,
                    status == CALIB_STALE ? "gap" : "jump");
            calib_rebase(&odometer);
            status = calib_feed_at(&odometer, left, right, t_s);
        }
        if (status != CALIB_OK) {
            fprintf(stderr, "replay: row %ld: sample refused, status %d\n", row, (int)status);
            continue;
        }
        (void)calib_get_pose(&odometer, &pose);
        printf("%.6f,%.9f,%.9f,%.9f\n", t_s, pose.x_m, pose.y_m, pose.theta_rad);
    }
    fprintf(stderr, "replay: %ld rows, %ld dropouts\n", row - 1, dropouts);
    return dropouts > 0;
}

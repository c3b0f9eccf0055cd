// The yardstick in C++: the beam update as one writes it first. Every beam is turned into the map,
// rounded to a cell, and every cell of its Bresenham line is visited in a dense array.
//
// A range r is used where nearest <= r < limit; all other beams are skipped.

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

struct Grid {
    double resolution;
    int64_t row, col;  // of the lower-left cell
    int64_t cols;
    int32_t *hits, *misses;  // dense, row by row; large enough for every beam, so no bounds check
};

// The cell of a coordinate that is rounded to 1/256 of a cell first.
static inline int64_t to_cell(double metres, double resolution) {
    return std::lrint(metres / resolution * 256) >> 8;
}

static inline void trace_beam(const Grid &grid, int64_t col, int64_t row, int64_t end_col,
                              int64_t end_row) {
    int64_t right = end_col > col ? 1 : -1;
    int64_t up = end_row > row ? grid.cols : -grid.cols;
    int64_t n = std::llabs(end_col - col), m = std::llabs(end_row - row);
    int64_t major = right, minor = up;
    if (m > n) {
        int64_t steps = n;
        n = m, m = steps;
        major = up, minor = right;
    }
    int32_t *cell = grid.misses + row * grid.cols + col;
    int64_t error = n;
    for (int64_t i = 0; i < n; ++i) {
        ++*cell;
        cell += major;
        error += 2 * m;
        if (error >= 2 * n) {
            error -= 2 * n;
            cell += minor;
        }
    }
    ++grid.hits[end_row * grid.cols + end_col];
}

// ranges: scans x beams; poses: scans x (x, y, yaw); the last arguments are those of the grid
extern "C" void trace(const float *ranges, const double *poses, int64_t scans, int64_t beams,
                      double angle_min, double angle_increment, float nearest, float limit,
                      double resolution, int64_t low_row, int64_t low_col, int64_t cols,
                      int32_t *hits, int32_t *misses) {
    const Grid grid{resolution, low_row, low_col, cols, hits, misses};
    std::vector<double> cosine(beams), sine(beams);
    for (int64_t b = 0; b < beams; ++b) {
        double bearing = angle_min + angle_increment * b;
        cosine[b] = std::cos(bearing);
        sine[b] = std::sin(bearing);
    }
    for (int64_t s = 0; s < scans; ++s) {
        double x = poses[3 * s], y = poses[3 * s + 1];
        double turn_x = std::cos(poses[3 * s + 2]), turn_y = std::sin(poses[3 * s + 2]);
        int64_t col = to_cell(x, grid.resolution) - grid.col;
        int64_t row = to_cell(y, grid.resolution) - grid.row;
        for (int64_t b = 0; b < beams; ++b) {
            float range = ranges[s * beams + b];
            if (!(range >= nearest && range < limit)) continue;
            double end_x = x + range * (turn_x * cosine[b] - turn_y * sine[b]);
            double end_y = y + range * (turn_y * cosine[b] + turn_x * sine[b]);
            trace_beam(grid, col, row, to_cell(end_x, grid.resolution) - grid.col,
                       to_cell(end_y, grid.resolution) - grid.row);
        }
    }
}

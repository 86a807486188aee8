/* Two hot kernels as a compiled extension would have them, for `python -m benchmarks.compiled_extension`. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#define LANES 16

static inline float exp2_minus(float r)
{
    /* 2^-r for r >= 0; coefficients as in numerics/kernels/rows.py */
    union { float f; int32_t i; } u;
    float f, p;
    int32_t whole;
    r = r < 125.0f ? r : 125.0f;
    whole = (int32_t)r;
    f = r - (float)whole;
    p = ((((-0.00093811647f * f + 0.00918687438f) * f - 0.05527813502f) * f + 0.24017158846f) * f
         - 0.69314217109f) * f + 0.99999992321f;
    u.f = p;
    u.i -= whole << 23;
    return u.f;
}

/* Add n Gaussians 2^-((scale r)^2), rows cx cy cz scale, to out[nz][ny][nx]; nx is a multiple of LANES. */
void add_points(float *restrict out, int64_t nz, int64_t ny, int64_t nx, const double *origin, const double *spacing,
                const double *points, int64_t n, double reach, float *restrict along)
{
    for (int64_t p = 0; p < n; p++) {
        const double *c = points + 4 * p, scale = c[3], radius = reach / scale;
        int64_t z0 = (int64_t)ceil((c[2] - radius - origin[2]) / spacing[2]);
        int64_t z1 = (int64_t)floor((c[2] + radius - origin[2]) / spacing[2]);
        int64_t y0 = (int64_t)ceil((c[1] - radius - origin[1]) / spacing[1]);
        int64_t y1 = (int64_t)floor((c[1] + radius - origin[1]) / spacing[1]);
        int64_t start = (int64_t)floor((c[0] - origin[0]) / spacing[0]);
        double rest = scale * (origin[0] + start * spacing[0] - c[0]), step = scale * spacing[0];
        float center = (float)(start - rest / step), inverse = (float)(1.0 / step), far = (float)(nx - 1);
        int64_t half = (int64_t)(radius / spacing[0]) + 2 * LANES;
        float first = (float)(rest - half * step), by = (float)step;
        z0 = z0 < 0 ? 0 : z0;
        y0 = y0 < 0 ? 0 : y0;
        z1 = z1 < nz - 1 ? z1 : nz - 1;
        y1 = y1 < ny - 1 ? y1 : ny - 1;
        if (z0 > z1 || y0 > y1)
            continue;
        for (int64_t i = 0; i < 2 * half / LANES * LANES; i++) {
            float x = first + by * (float)(int32_t)i;
            along[i] = exp2_minus(x * x);
        }
        for (int64_t z = z0; z <= z1; z++) {
            float dz = (float)(scale * (origin[2] + z * spacing[2] - c[2]));
            for (int64_t y = y0; y <= y1; y++) {
                float dy = (float)(scale * (origin[1] + y * spacing[1] - c[1]));
                float aside = dy * dy + dz * dz, chord2 = (float)reach * (float)reach - aside;
                if (chord2 < 0.0f)
                    continue;
                float chord = sqrtf(chord2) * inverse, factor = exp2_minus(aside);
                float low = fmaxf(ceilf(center - chord), 0.0f), high = fminf(floorf(center + chord), far);
                if (high < low)
                    continue;
                int64_t blocks = (int64_t)((high - low) * (1.0f / LANES)) + 1, x0 = (int64_t)low;
                if (x0 + blocks * LANES > nx)
                    x0 = nx - blocks * LANES;
                float *target = out + (z * ny + y) * nx + x0;
                const float *source = along + x0 + half - start;
                for (int64_t b = 0; b < blocks; b++, target += LANES, source += LANES)
                    for (int i = 0; i < LANES; i++)
                        target[i] += factor * source[i];
            }
        }
    }
}

/* Runs of a mask[rows][nx] of zeros and ones: starts[rows + 1], bounds; the number of bounds, or -1 if they don't fit. */
int64_t find_runs(const uint8_t *mask, int64_t rows, int64_t nx, int64_t *starts, int32_t *bounds, int64_t room)
{
    int64_t n = 0;
    for (int64_t y = 0; y < rows; y++) {
        const uint8_t *row = mask + y * nx;
        uint64_t carry = 0;
        starts[y] = n / 2;
        if (n + 2 * (nx / 2 + 1) > room)
            return -1;
        for (int64_t x = 0; x < nx; x += 64) {
            uint64_t packed = 0;
            int64_t count = nx - x < 64 ? nx - x : 64;
            if (count == 64)
                for (int b = 0; b < 8; b++) {
                    uint64_t word;
                    memcpy(&word, row + x + 8 * b, 8);
                    packed |= ((word * 0x0102040810204080ull) >> 56) << (8 * b);
                }
            else
                for (int64_t i = 0; i < count; i++)
                    packed |= (uint64_t)(row[x + i] != 0) << i;
            uint64_t change = packed ^ ((packed << 1) | carry);
            carry = packed >> 63;
            for (; change; change &= change - 1)
                bounds[n++] = (int32_t)(x + __builtin_ctzll(change));
        }
        if (n % 2)
            bounds[n++] = (int32_t)nx;
    }
    starts[rows] = n / 2;
    return n;
}

// Normals of the surface that a depth map shows, and their gradient: a thread a pixel.
#include "pixel_rays.cuh"

using namespace envgs;

// The surface around a pixel, by its four neighbors.
struct Stencil {
    Vec3<float> down, right;  // from the upper to the lower neighbor, from the left to the right one
    bool complete;            // inside the border, and all four have a depth

    __device__ Stencil(const PinholeCamera& camera, const float* depth, int column, int row) {
        complete = column > 0 && row > 0 && column < camera.width - 1 && row < camera.height - 1;
        if (!complete) return;
        const float* at = depth + long(row) * camera.width + column;
        float above = at[-camera.width], below = at[camera.width], left = at[-1], rightmost = at[1];
        complete = above > 0.0f && below > 0.0f && left > 0.0f && rightmost > 0.0f;
        down = below * ray_through(camera, column, row + 1) - above * ray_through(camera, column, row - 1);
        right = rightmost * ray_through(camera, column + 1, row) - left * ray_through(camera, column - 1, row);
    }
};

extern "C" __global__ void __launch_bounds__(256)
    depth_normals(const PinholeCamera* camera,  // [1]
                  const float* depth,           // [H, W] camera-frame z, 0 where nothing is hit
                  float* normals  // [3, H, W] unit, world frame, facing the camera; 0 where the stencil is incomplete
    ) {
    int i = blockIdx.x * blockDim.x + threadIdx.x, pixels = camera->width * camera->height;
    if (i >= pixels) return;
    Stencil stencil(*camera, depth, i % camera->width, i / camera->width);
    Vec3<float> n = {0.0f, 0.0f, 0.0f};
    if (stencil.complete) {
        n = cross(stencil.down, stencil.right);
        n = rsqrtf(maximum(dot(n, n), 1e-24f)) * n;
    }
    normals[i] = n.x, normals[pixels + i] = n.y, normals[2 * pixels + i] = n.z;
}

// The gradient of depth_normals: a pixel is a neighbor in four stencils.
extern "C" __global__ void __launch_bounds__(256)
    differentiate_depth_normals(const PinholeCamera* camera,  // [1]
                                const float* depth,           // [H, W] camera-frame z, 0 where nothing is hit
                                const float* g_normals,       // [3, H, W] dL/dnormals
                                float* g_depth                // [H, W] dL/ddepth
    ) {
    int i = blockIdx.x * blockDim.x + threadIdx.x, pixels = camera->width * camera->height;
    if (i >= pixels) return;
    int column = i % camera->width, row = i / camera->width;
    Vec3<float> g_point = {0.0f, 0.0f, 0.0f};
    for (int side = 0; side < 4; ++side) {
        bool vertical = side < 2, ahead = side % 2;  // the stencil's center lies behind this pixel, or ahead of it
        int step = ahead ? 1 : -1, x = vertical ? column : column + step, y = vertical ? row + step : row;
        Stencil stencil(*camera, depth, x, y);
        if (!stencil.complete) continue;
        const float* at = g_normals + long(y) * camera->width + x;
        Vec3<float> n = cross(stencil.down, stencil.right), g = {at[0], at[pixels], at[2l * pixels]};
        float squared = dot(n, n), inverse = rsqrtf(maximum(squared, 1e-24f));
        g = squared > 1e-24f ? normalize_backward(inverse * n, inverse, g) : inverse * g;
        g = vertical ? cross(stencil.right, g) : cross(g, stencil.down);
        g_point = ahead ? g_point - g : g_point + g;
    }
    g_depth[i] = dot(g_point, ray_through(*camera, column, row));
}

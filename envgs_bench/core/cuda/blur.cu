// SSIM's window over many planes: a block of 256 threads a tile, rows first, then columns, in shared memory.

constexpr int WINDOW = 11, TILE_WIDTH = 32, TILE_HEIGHT = 16;
constexpr int LOADED_WIDTH = TILE_WIDTH + WINDOW - 1, LOADED_HEIGHT = TILE_HEIGHT + WINDOW - 1;

// `images` [planes, height, width], zero beyond their borders, become `blurred` [planes, height + 2·pad − 10,
// width + 2·pad − 10]; `taps` [11] weigh rows and columns alike. Blocks count tiles from left to right, then downwards,
// then by plane.
extern "C" __global__ void __launch_bounds__(256)
    blur_planes(const float* images, int height, int width, int pad, const float* taps, float* blurred) {
    __shared__ float loaded[LOADED_HEIGHT * LOADED_WIDTH], rows[LOADED_HEIGHT * TILE_WIDTH];
    int out_height = height + 2 * pad - (WINDOW - 1), out_width = width + 2 * pad - (WINDOW - 1);
    int across = (out_width + TILE_WIDTH - 1) / TILE_WIDTH, down = (out_height + TILE_HEIGHT - 1) / TILE_HEIGHT;
    int plane = blockIdx.x / (across * down), tile = blockIdx.x % (across * down);
    int left = tile % across * TILE_WIDTH, top = tile / across * TILE_HEIGHT;
    images += long(plane) * height * width, blurred += long(plane) * out_height * out_width;

    float weights[WINDOW];
    for (int k = 0; k < WINDOW; k++) weights[k] = taps[k];
    for (int i = threadIdx.x; i < LOADED_HEIGHT * LOADED_WIDTH; i += 256) {
        int y = top - pad + i / LOADED_WIDTH, x = left - pad + i % LOADED_WIDTH;
        bool inside = y >= 0 && y < height && x >= 0 && x < width;
        loaded[i] = inside ? images[long(y) * width + x] : 0.0f;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < LOADED_HEIGHT * TILE_WIDTH; i += 256) {
        const float* window = loaded + i / TILE_WIDTH * LOADED_WIDTH + i % TILE_WIDTH;
        float sum = 0.0f;
        for (int k = 0; k < WINDOW; k++) sum += weights[k] * window[k];
        rows[i] = sum;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < TILE_HEIGHT * TILE_WIDTH; i += 256) {
        int y = top + i / TILE_WIDTH, x = left + i % TILE_WIDTH;
        float sum = 0.0f;
        for (int k = 0; k < WINDOW; k++) sum += weights[k] * rows[i + k * TILE_WIDTH];
        if (y < out_height && x < out_width) blurred[long(y) * out_width + x] = sum;
    }
}

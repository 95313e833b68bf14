// SSIM's window over many planes: a block of 256 threads a tile, rows first, then columns, in shared memory.

constexpr int kWindow = 11, kTileWidth = 32, kTileHeight = 16;
constexpr int kLoadedWidth = kTileWidth + kWindow - 1, kLoadedHeight = kTileHeight + kWindow - 1;

// `images` [planes, height, width], zero beyond their borders, become `blurred` [planes, height + 2·pad − 10,
// width + 2·pad − 10]; `taps` [11] weigh rows and columns alike. Blocks count tiles from left to right, then downwards,
// then by plane.
extern "C" __global__ void __launch_bounds__(256)
    blur_planes(const float* images, int height, int width, int pad, const float* taps, float* blurred) {
    __shared__ float loaded[kLoadedHeight * kLoadedWidth], rows[kLoadedHeight * kTileWidth];
    int out_height = height + 2 * pad - (kWindow - 1), out_width = width + 2 * pad - (kWindow - 1);
    int across = (out_width + kTileWidth - 1) / kTileWidth, down = (out_height + kTileHeight - 1) / kTileHeight;
    int plane = blockIdx.x / (across * down), tile = blockIdx.x % (across * down);
    int left = tile % across * kTileWidth, top = tile / across * kTileHeight;
    images += long(plane) * height * width, blurred += long(plane) * out_height * out_width;

    float weights[kWindow];
    for (int k = 0; k < kWindow; ++k) weights[k] = taps[k];
    for (int i = threadIdx.x; i < kLoadedHeight * kLoadedWidth; i += 256) {
        int y = top - pad + i / kLoadedWidth, x = left - pad + i % kLoadedWidth;
        bool inside = y >= 0 && y < height && x >= 0 && x < width;
        loaded[i] = inside ? images[long(y) * width + x] : 0.0f;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < kLoadedHeight * kTileWidth; i += 256) {
        const float* window = loaded + i / kTileWidth * kLoadedWidth + i % kTileWidth;
        float sum = 0.0f;
        for (int k = 0; k < kWindow; ++k) sum += weights[k] * window[k];
        rows[i] = sum;
    }
    __syncthreads();
    for (int i = threadIdx.x; i < kTileHeight * kTileWidth; i += 256) {
        int y = top + i / kTileWidth, x = left + i % kTileWidth;
        float sum = 0.0f;
        for (int k = 0; k < kWindow; ++k) sum += weights[k] * rows[i + k * kTileWidth];
        if (y < out_height && x < out_width) blurred[long(y) * out_width + x] = sum;
    }
}

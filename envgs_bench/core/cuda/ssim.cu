// Structural similarity of two images and its gradient (formulas: ssim.py): a block of 256 threads a tile of one
// channel, the window along rows first, then along columns, in shared memory.

constexpr int kWindow = 11, kTileWidth = SSIM_TILE_WIDTH, kTileHeight = SSIM_TILE_HEIGHT;
constexpr int kLoadedWidth = kTileWidth + kWindow - 1, kLoadedHeight = kTileHeight + kWindow - 1;
constexpr int kLoaded = kLoadedHeight * kLoadedWidth, kRows = kLoadedHeight * kTileWidth,
              kTilePixels = kTileHeight * kTileWidth;

// A channel of an image, zero beyond its borders.
struct Channel {
    const float* values;
    int height, width;

    __device__ float at(int row, int column) const {
        bool inside = row >= 0 && row < height && column >= 0 && column < width;
        return inside ? values[long(row) * width + column] : 0.0f;
    }
};

// Which tile is the block's: they are counted from left to right, then downward, then by channel.
struct Tile {
    int channel, top, left;

    __device__ Tile(int height, int width) {
        int across = (width + kTileWidth - 1) / kTileWidth, down = (height + kTileHeight - 1) / kTileHeight;
        channel = blockIdx.x / (across * down);
        int tile = blockIdx.x % (across * down);
        top = tile / across * kTileHeight, left = tile % across * kTileWidth;
    }
};

// SSIM of two images. Where `partials` is given, it becomes the derivative of each value with respect to the blurred x,
// x² + y² and x·y, half of it for the first and last.
extern "C" __global__ void __launch_bounds__(256)
    ssim_map(const float* image,   // [C, H, W] in [0, 1]
             const float* target,  // [C, H, W] in [0, 1]
             int channels,         // C
             int height,           // H, pixels
             int width,            // W, pixels
             int pad,              // zeros on every side, pixels
             const float* taps,    // [11] weights of the window, which sum to 1
             float c1,             // C₁ of the formula
             float c2,             // C₂ of the formula
             float* similarity,    // [C, H + 2·pad − 10, W + 2·pad − 10]
             float* partials       // [3, C, …], or null: derivatives by the blurred x, x² + y² and x·y
    ) {
    __shared__ float xs[kLoaded], ys[kLoaded], rows[4][kRows];
    int out_height = height + 2 * pad - (kWindow - 1), out_width = width + 2 * pad - (kWindow - 1);
    Tile tile(out_height, out_width);
    long first_pixel = long(tile.channel) * height * width;
    Channel x = {image + first_pixel, height, width}, y = {target + first_pixel, height, width};
    float weights[kWindow];
    for (int k = 0; k < kWindow; ++k) weights[k] = taps[k];
    for (int i = threadIdx.x; i < kLoaded; i += 256) {
        int row = tile.top - pad + i / kLoadedWidth, column = tile.left - pad + i % kLoadedWidth;
        xs[i] = x.at(row, column), ys[i] = y.at(row, column);
    }
    __syncthreads();
    for (int i = threadIdx.x; i < kRows; i += 256) {
        int first = i / kTileWidth * kLoadedWidth + i % kTileWidth;
        float sums[4] = {};
        for (int k = 0; k < kWindow; ++k) {
            float u = xs[first + k], v = ys[first + k], w = weights[k];
            sums[0] += w * u, sums[1] += w * v, sums[2] += w * (u * u + v * v), sums[3] += w * (u * v);
        }
        for (int k = 0; k < 4; ++k) rows[k][i] = sums[k];
    }
    __syncthreads();
    long values = long(out_height) * out_width;
    for (int i = threadIdx.x; i < kTilePixels; i += 256) {
        int row = tile.top + i / kTileWidth, column = tile.left + i % kTileWidth;
        if (row >= out_height || column >= out_width) continue;
        float sums[4] = {};
        for (int k = 0; k < kWindow; ++k)
            for (int term = 0; term < 4; ++term) sums[term] += weights[k] * rows[term][i + k * kTileWidth];
        float mean_x = sums[0], mean_y = sums[1];
        float product = mean_x * mean_y, squares = mean_x * mean_x + mean_y * mean_y;
        float a1 = 2.0f * product + c1, a2 = 2.0f * (sums[3] - product) + c2;
        float b1 = squares + c1, b2 = sums[2] - squares + c2;
        float scale = 1.0f / (b1 * b2), value = a1 * a2 * scale;
        long at = tile.channel * values + long(row) * out_width + column;
        similarity[at] = value;
        if (!partials) continue;
        float to_squares = -value / b2;
        partials[at] = (a2 - a1) * mean_y * scale - (to_squares + value / b1) * mean_x;
        partials[channels * values + at] = to_squares;
        partials[2 * channels * values + at] = a1 * scale;
    }
}

// The gradient of `image`, from ssim_map's partials and the gradient of its values.
extern "C" __global__ void __launch_bounds__(256)
    differentiate_ssim_map(const float* image,     // [C, H, W] in [0, 1]
                           const float* target,    // [C, H, W] in [0, 1]
                           const float* gradient,  // [C, H + 2·pad − 10, W + 2·pad − 10] dL/dsimilarity
                           const float* partials,  // [3, C, …] from ssim_map
                           int channels,           // C
                           int height,             // H, pixels
                           int width,              // W, pixels
                           int pad,                // zeros on every side, pixels
                           const float* taps,      // [11] weights of the window
                           float* g_image          // [C, H, W] dL/dimage
    ) {
    __shared__ float loaded[3][kLoaded], rows[3][kRows];
    int map_height = height + 2 * pad - (kWindow - 1), map_width = width + 2 * pad - (kWindow - 1);
    int border = kWindow - 1 - pad;
    Tile tile(height, width);
    long values = long(map_height) * map_width;
    Channel g = {gradient + tile.channel * values, map_height, map_width};
    float weights[kWindow];
    for (int k = 0; k < kWindow; ++k) weights[k] = taps[k];
    for (int i = threadIdx.x; i < kLoaded; i += 256) {
        int row = tile.top - border + i / kLoadedWidth, column = tile.left - border + i % kLoadedWidth;
        float upstream = g.at(row, column);
        for (int term = 0; term < 3; ++term) {
            Channel partial = {partials + (long(term) * channels + tile.channel) * values, map_height, map_width};
            loaded[term][i] = upstream * partial.at(row, column);
        }
    }
    __syncthreads();
    for (int i = threadIdx.x; i < kRows; i += 256) {
        int first = i / kTileWidth * kLoadedWidth + i % kTileWidth;
        float sums[3] = {};
        for (int k = 0; k < kWindow; ++k)
            for (int term = 0; term < 3; ++term) sums[term] += weights[k] * loaded[term][first + k];
        for (int term = 0; term < 3; ++term) rows[term][i] = sums[term];
    }
    __syncthreads();
    long first_pixel = long(tile.channel) * height * width;
    Channel x = {image + first_pixel, height, width}, y = {target + first_pixel, height, width};
    for (int i = threadIdx.x; i < kTilePixels; i += 256) {
        int row = tile.top + i / kTileWidth, column = tile.left + i % kTileWidth;
        if (row >= height || column >= width) continue;
        float sums[3] = {};
        for (int k = 0; k < kWindow; ++k)
            for (int term = 0; term < 3; ++term) sums[term] += weights[k] * rows[term][i + k * kTileWidth];
        g_image[first_pixel + long(row) * width + column] =
            2.0f * (sums[0] + sums[1] * x.at(row, column) + sums[2] * y.at(row, column));
    }
}

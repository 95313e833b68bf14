// One step of Adam (Kingma and Ba 2015, Alg. 1) for one tensor: four values a thread.

namespace {

struct Step {
    float beta1, beta2, epsilon;
    float size;          // learning rate, divided by what the mean is short of
    float square_scale;  // divides squares by what they are short of

    __device__ void operator()(float& value, float gradient, float& mean, float& square) const {
        mean = beta1 * mean + (1.0f - beta1) * gradient;
        square = beta2 * square + (1.0f - beta2) * gradient * gradient;
        value -= size * mean / (sqrtf(square * square_scale) + epsilon);
    }
};

}  // namespace

extern "C" __global__ void __launch_bounds__(256)
    adam_step(float* values,           // [n] that are trained
              const float* gradients,  // [n] dL/dvalues
              float* means,            // [n] of the gradients, decaying
              float* squares,          // [n] of the gradients, decaying
              int n,                   // values
              const float* rate,       // [1] learning rate
              const float* steps,      // [1] taken, this one included
              const float* skipped,    // [1] whether this step is not to be taken; null: it is
              float beta1,             // decay of the means
              float beta2,             // decay of the squares
              float epsilon            // added to the root of the squares
    ) {
    if (skipped && *skipped != 0.0f) return;
    Step step = {beta1, beta2, epsilon};
    // 1 - beta^steps, without the digits that it loses where beta is near 1.
    step.size = *rate / -expm1f(*steps * logf(beta1));
    step.square_scale = 1.0f / -expm1f(*steps * logf(beta2));
    int first = 4 * (blockIdx.x * blockDim.x + threadIdx.x);
    if (first + 4 <= n) {
        float4 value = reinterpret_cast<float4*>(values)[first / 4], mean = reinterpret_cast<float4*>(means)[first / 4];
        float4 square = reinterpret_cast<float4*>(squares)[first / 4];
        float4 gradient = reinterpret_cast<const float4*>(gradients)[first / 4];
        step(value.x, gradient.x, mean.x, square.x);
        step(value.y, gradient.y, mean.y, square.y);
        step(value.z, gradient.z, mean.z, square.z);
        step(value.w, gradient.w, mean.w, square.w);
        reinterpret_cast<float4*>(values)[first / 4] = value;
        reinterpret_cast<float4*>(means)[first / 4] = mean;
        reinterpret_cast<float4*>(squares)[first / 4] = square;
        return;
    }
    for (int i = first; i < n; ++i) step(values[i], gradients[i], means[i], squares[i]);
}

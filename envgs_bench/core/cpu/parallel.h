// The loops that the backend runs on all cores. Work is dealt to workers in a fixed pattern, so that what a worker sums
// up, and with it every bit of the result, depends on the number of workers only.
//
// OpenMP, because torch brings its runtime along: two pools of threads that wait for work by spinning would take each
// other's cores. Without OpenMP the same loops run on one core.
#pragma once

namespace envgs {

// work(worker) for each worker in [0, workers).
template <class Work>
void parallel(int workers, const Work& work) {
#pragma omp parallel for schedule(static, 1) num_threads(workers)
    for (int worker = 0; worker < workers; ++worker) work(worker);
}

// item(i, worker) for i in [0, count), worker w taking i = w, w + workers, …
template <class Item>
void parallel_interleaved(int workers, int count, const Item& item) {
    parallel(workers, [&](int worker) {
        for (int i = worker; i < count; i += workers) item(i, worker);
    });
}

// range(begin, end, worker): worker w takes the w-th of equal consecutive parts of [0, count).
template <class Range>
void parallel_ranges(int workers, int count, const Range& range) {
    parallel(workers, [&](int worker) {
        range(int(long(count) * worker / workers), int(long(count) * (worker + 1) / workers), worker);
    });
}

}  // namespace envgs

// The loops that the backend runs on all cores. Work is dealt to workers in a fixed pattern, so that what a worker sums
// up, and with it every bit of the result, depends on the number of workers only.
//
// OpenMP, because torch brings its runtime along: two pools of threads that wait for work by spinning would take each
// other's cores. Without OpenMP the same loops run on one core.
#pragma once
#if defined(_OPENMP)
#include <omp.h>

#include <chrono>
#include <thread>
#endif

namespace envgs {

// From now on threads that wait for others, torch's too, sleep. By default GNU's runtime lets them spin for milliseconds,
// and beside another program they spin while that holds the core of the one they wait for. It has no call for this once
// it is loaded, but spins a hundred times only where there are more threads than CPUs: so there are, asleep.
inline void sleep_while_waiting() {
#if defined(_OPENMP)
    std::thread([] {
#pragma omp parallel num_threads(omp_get_num_procs() + 1)
        asm volatile("");  // or the team would never be made
        for (;;) std::this_thread::sleep_for(std::chrono::hours(24));
    }).detach();
#endif
}

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

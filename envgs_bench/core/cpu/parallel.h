// The loops that the backend runs on all cores. Work is dealt to workers in a fixed pattern, so that what a worker sums
// up, and with it every bit of the result, depends on the number of workers only.
//
// OpenMP, because torch brings its runtime along: two pools of threads that wait for work by spinning would take each
// other's cores. Without OpenMP the same loops run on one core.
#pragma once
#include <exception>
#if defined(_OPENMP)
#include <omp.h>

#include <chrono>
#include <future>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>
#endif

namespace envgs {

#if defined(_OPENMP)
// Whether the system lets this process start `count` more threads: they are started, and end again.
inline bool threads_can_be_had(int count) {
    std::promise<void> end;
    const std::shared_future<void> ended = end.get_future().share();
    std::vector<std::thread> had;
    had.reserve(count);
    try {
        while (int(had.size()) < count) had.emplace_back([ended] { ended.wait(); });
    } catch (const std::system_error&) {  // too many processes, or no memory for a stack
    }
    end.set_value();
    for (std::thread& thread : had) thread.join();
    return int(had.size()) == count;
}
#endif

// From now on threads that wait for others, torch's too, sleep. By default GNU's runtime lets them spin for
// milliseconds, and beside another program they spin while that holds the core of the one they wait for. It has no call
// for this once it is loaded, but spins a hundred times only where there are more threads than CPUs: so there are,
// asleep.
//
// That costs no time and next to no memory, but the addresses of a stack a thread (8 MB as most systems are set up),
// which RLIMIT_AS and RLIMIT_DATA count, and CPUs + 1 of the threads that a user or a container may have. The runtime
// ends the process where it cannot start a thread. So they are started only where there is room for as many again,
// which torch will ask for; elsewhere threads go on spinning.
inline void sleep_while_waiting() {
#if defined(_OPENMP)
    const int sleepers = omp_get_num_procs() + 1;
    if (!threads_can_be_had(2 * sleepers)) return;
    std::promise<void> promise;
    std::future<void> started = promise.get_future();
    try {
        std::thread([sleepers, promise = std::move(promise)]() mutable {
#pragma omp parallel num_threads(sleepers)
            {
                if (omp_get_thread_num() == 0) promise.set_value();  // by now the runtime has started them all
                for (;;) std::this_thread::sleep_for(std::chrono::hours(24));
            }
        }).detach();
    } catch (const std::system_error&) {  // somebody else took the room
        return;
    }
    started.wait();  // a limit that the caller sets next is not to meet them half started
#endif
}

// work(worker) for each worker in [0, workers). What one of them throws, for want of memory say, is thrown once all
// have ended: an exception that left the OpenMP region would end the process.
template <class Work>
void parallel(int workers, const Work& work) {
    std::exception_ptr thrown;
#pragma omp parallel for schedule(static, 1) num_threads(workers)
    for (int worker = 0; worker < workers; ++worker) {
        try {
            work(worker);
        } catch (...) {
#pragma omp critical
            thrown = std::current_exception();
        }
    }
    if (thrown) std::rethrow_exception(thrown);
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

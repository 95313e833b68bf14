// A pool of threads, and the one loop that the backend needs. Items are dealt to workers in a fixed pattern, so that
// what a worker sums up, and with it every bit of the result, depends on the number of threads only.
#pragma once
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace envgs {

// Lives as long as the process: its threads sleep between calls and are never joined.
class ThreadPool {
public:
    static ThreadPool& shared();

    // Runs work(0) … work(workers − 1), the first on the calling thread, and returns when all are done. `work` must not
    // throw and must not call run().
    void run(int workers, const std::function<void(int)>& work);

private:
    void serve(int worker);

    std::mutex busy_, mutex_;
    std::condition_variable start_, done_;
    std::vector<std::thread> threads_;
    const std::function<void(int)>* work_ = nullptr;
    unsigned long generation_ = 0;
    int wanted_ = 0, remaining_ = 0;
};

// item(i, worker) for i in [0, count), worker w taking i = w, w + workers, …
template <class Item>
void parallel_interleaved(int workers, int count, const Item& item) {
    ThreadPool::shared().run(workers, [&](int worker) {
        for (int i = worker; i < count; i += workers) item(i, worker);
    });
}

// range(begin, end, worker): worker w takes the w-th of equal consecutive parts of [0, count).
template <class Range>
void parallel_ranges(int workers, int count, const Range& range) {
    ThreadPool::shared().run(workers, [&](int worker) {
        range(int(long(count) * worker / workers), int(long(count) * (worker + 1) / workers), worker);
    });
}

}  // namespace envgs

#include "parallel.h"

#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

namespace envgs {

namespace {
ThreadPool* pool = nullptr;
}

ThreadPool& ThreadPool::shared() {
    static std::once_flag once;
    std::call_once(once, [] {
        pool = new ThreadPool;
#if defined(__unix__) || defined(__APPLE__)
        // A forked child has the pool's memory but none of its threads: it starts another.
        pthread_atfork(nullptr, nullptr, [] { pool = new ThreadPool; });
#endif
    });
    return *pool;
}

void ThreadPool::run(int workers, const std::function<void(int)>& work) {
    if (workers <= 1) {
        work(0);
        return;
    }
    std::lock_guard<std::mutex> one_caller(busy_);
    {
        std::lock_guard<std::mutex> lock(mutex_);
        while (int(threads_.size()) < workers - 1) {
            int worker = int(threads_.size()) + 1;
            threads_.emplace_back([this, worker] { serve(worker); });
        }
        work_ = &work;
        wanted_ = workers;
        remaining_ = workers - 1;
        ++generation_;
    }
    start_.notify_all();
    work(0);
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return remaining_ == 0; });
}

void ThreadPool::serve(int worker) {
    unsigned long seen = 0;
    for (;;) {
        const std::function<void(int)>* work;
        {
            std::unique_lock<std::mutex> lock(mutex_);
            start_.wait(lock, [&] { return generation_ != seen && worker < wanted_; });
            seen = generation_;
            work = work_;
        }
        (*work)(worker);
        std::lock_guard<std::mutex> lock(mutex_);
        if (--remaining_ == 0) done_.notify_one();
    }
}

}  // namespace envgs

// Runs a block's threads on stacks of their own, one at a time: each until it has to wait for others at a barrier or an
// operation of its warp. Blocks run one after the other.
#include "emulator.h"

#include <ucontext.h>
#include <algorithm>
#include <csetjmp>
#include <csignal>
#include <cstdarg>
#include <cstdio>
#include <memory>
#include <numeric>

Coordinates threadIdx, blockIdx, blockDim, gridDim;

// The linker's names for where shared memory begins and ends; null where the kernels have none.
extern "C" __attribute__((weak, visibility("hidden"))) char __start_emulated_shared[], __stop_emulated_shared[];

namespace emulator {
namespace {

constexpr unsigned kMaxThreads = 1024;
constexpr size_t kStackBytes = 256 << 10;
constexpr unsigned kMaxRounds = 300'000;  // scheduling rounds that a block may take
enum Order { ascending, descending, shuffled };

// Threads that wait for each other: a warp or a block.
struct Group {
    unsigned living = 0, arrived = 0;
    unsigned phase = 0;  // how often all its threads have synchronized
    Operation operation = Operation::none;
};
struct Warp : Group {
    WarpExchange two[2];  // some lanes may not have read the last exchange's values when others come to the next
};
struct Block : Group {
    bool any[2];
};

struct Thread {
    std::unique_ptr<char[]> stack{new char[kStackBytes]};
    ucontext_t first;  // before it has ever run
    jmp_buf place;     // where it goes on
    bool has_run = false, ended = true;
    const Group* waits_for = nullptr;
    unsigned phase = 0;  // the group's phase at which it began to wait

    bool can_run() const { return !ended && !(waits_for && waits_for->phase == phase); }
};

Thread threads[kMaxThreads];
Warp warps[kMaxThreads / 32];
Block block;
jmp_buf scheduler;
ucontext_t scheduler_context;
Body body;
void* kernel_and_arguments;
char error[400];

void close_if_complete(Group& group) {
    if (group.arrived == 0 || group.arrived < group.living) return;
    group.arrived = 0;
    ++group.phase;
}

void fail_block(const char* message) {
    if (!error[0]) std::snprintf(error, sizeof error, "%s, block %u", message, blockIdx.x);
}

__attribute__((noinline)) void to_scheduler(Thread& self) {
    if (_setjmp(self.place) == 0) _longjmp(scheduler, 1);
}

__attribute__((noinline)) void to_thread(unsigned index) {
    Thread& thread = threads[index];
    threadIdx.x = index;
    if (_setjmp(scheduler) != 0) return;
    if (thread.has_run) _longjmp(thread.place, 1);
    thread.has_run = true;
    setcontext(&thread.first);
}

// A thread serves one block after the other.
void serve() {
    for (;;) {
        body(kernel_and_arguments);
        Thread& self = threads[threadIdx.x];
        Warp& warp = warps[threadIdx.x / 32];
        self.ended = true;
        --warp.living, --block.living;
        close_if_complete(warp);
        close_if_complete(block);
        to_scheduler(self);
    }
}

void arrive(Group& group, Operation operation) {
    if (group.arrived++ == 0) group.operation = operation;
    if (group.operation != operation)
        fail("threads of one group are at different operations (%d and %d)", int(group.operation), int(operation));
    Thread& self = threads[threadIdx.x];
    self.waits_for = &group, self.phase = group.phase;
    close_if_complete(group);
    if (!self.can_run()) to_scheduler(self);
    self.waits_for = nullptr;
}

void start_block(unsigned count) {
    block.living = count, block.arrived = 0;
    for (Warp& warp : warps) warp.living = warp.arrived = 0;
    for (unsigned t = 0; t < count; ++t) {
        Thread& thread = threads[t];
        ++warps[t / 32].living;
        thread.ended = false, thread.waits_for = nullptr;
        if (thread.has_run) continue;
        getcontext(&thread.first);
        thread.first.uc_stack = {.ss_sp = thread.stack.get(), .ss_flags = 0, .ss_size = kStackBytes};
        thread.first.uc_link = nullptr;
        makecontext(&thread.first, serve, 0);
    }
}

void shuffle(unsigned* values, unsigned count) {
    static uint32_t state = 1;
    for (unsigned k = count - 1; k > 0; --k) {
        state = state * 1664525 + 1013904223;
        std::swap(values[k], values[uint64_t(state) * (k + 1) >> 32]);
    }
}

// Lets each of the threads go on that can; whether any could.
bool give_turns(const unsigned* turns, unsigned count) {
    bool any = false;
    for (unsigned k = 0; k < count && !error[0]; ++k) {
        if (!threads[turns[k]].can_run()) continue;
        any = true;
        to_thread(turns[k]);
    }
    return any;
}

// In order, a warp goes on as far as it can before the next does. Shuffled, all threads keep about abreast.
void run_block(unsigned count, int order) {
    unsigned turns[kMaxThreads];
    std::iota(turns, turns + count, 0u);
    if (order == descending) std::reverse(turns, turns + count);
    std::memset(__start_emulated_shared, 0xff, __stop_emulated_shared - __start_emulated_shared);
    start_block(count);
    for (unsigned rounds = 0; block.living && !error[0];) {
        bool any = false;
        if (order == shuffled) {
            shuffle(turns, count);
            any = give_turns(turns, count);
        } else {
            for (unsigned first = 0; first < count; first += 32)
                for (; give_turns(turns + first, std::min(32u, count - first)) && rounds < kMaxRounds; ++rounds)
                    any = true;
        }
        if (!any) fail_block("deadlock: every thread waits for others");
        if (++rounds > kMaxRounds) fail_block("does not end");
    }
}

// Where a kernel leaves its memory, the launch has failed, not the process.
void on_bad_address(int) { fail("reads or writes outside all memory"); }

}  // namespace

const WarpExchange& synchronize_warp(Operation operation, uint64_t value) {
    Warp& warp = warps[threadIdx.x / 32];
    WarpExchange& exchange = warp.two[warp.phase & 1];
    if (warp.arrived == 0) exchange.present = 0;
    exchange.present |= 1u << (threadIdx.x & 31);
    exchange.values[threadIdx.x & 31] = value;
    arrive(warp, operation);
    return exchange;
}

bool synchronize_block(Operation operation, bool value) {
    bool& any = block.any[block.phase & 1];
    if (block.arrived == 0) any = false;
    any |= value;
    arrive(block, operation);
    return any;
}

void fail(const char* format, ...) {
    va_list values;
    va_start(values, format);
    int length = std::vsnprintf(error, sizeof error, format, values);
    va_end(values);
    std::snprintf(error + length, sizeof error - length, ", in thread %u of block %u", threadIdx.x, blockIdx.x);
    _longjmp(scheduler, 1);
}

const char* run(unsigned blocks, unsigned count, int order, Body the_body, void* data) {
    if (count == 0 || count > kMaxThreads) return "a block has 1 to 1024 threads";
    body = the_body, kernel_and_arguments = data;
    blockDim.x = count, gridDim.x = blocks;
    error[0] = '\0';
    struct sigaction catching = {}, before;
    catching.sa_handler = on_bad_address;
    catching.sa_flags = SA_NODEFER;  // it does not return
    sigaction(SIGSEGV, &catching, &before);
    for (unsigned k = 0; k < blocks && !error[0]; ++k) {
        blockIdx.x = order == descending ? blocks - 1 - k : k;
        run_block(count, order);
    }
    sigaction(SIGSEGV, &before, nullptr);
    if (!error[0]) return nullptr;
    for (Thread& thread : threads) thread.has_run = false;  // what was under way is abandoned
    return error;
}

}  // namespace emulator

// What the compiler's checks call where an address is not aligned or an index lies outside its array: an error of the
// launch, where the compiler's own library would end the process.
struct CheckedPlace {
    const char* file;
    unsigned line, column;
};
extern "C" void __ubsan_handle_type_mismatch_v1_abort(CheckedPlace* place, void* address) {
    emulator::fail("%s:%u: %p is not aligned", place->file, place->line, address);
}
extern "C" void __ubsan_handle_out_of_bounds_abort(CheckedPlace* place, uintptr_t index) {
    emulator::fail("%s:%u: index %lu is outside the array", place->file, place->line, (unsigned long)index);
}

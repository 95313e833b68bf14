// Which of the targets that the extension is compiled for this CPU runs.
#pragma once
#include <string>
#include <vector>

namespace envgs {

// The best first; names as in CMakeLists.txt.
inline std::vector<std::string> supported_targets() {
#if defined(__x86_64__)
    __builtin_cpu_init();
    bool v2 = __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    bool v3 = v2 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
              __builtin_cpu_supports("bmi2");
    bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
              __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
              __builtin_cpu_supports("avx512vl");
    std::vector<std::string> names;
    if (v4) names.push_back("x86-64-v4");
    if (v3) names.push_back("x86-64-v3");
    if (v2) names.push_back("x86-64-v2");
    return names;
#elif defined(__APPLE__)
    return {"arm64"};
#else
    return {"aarch64"};
#endif
}

}  // namespace envgs

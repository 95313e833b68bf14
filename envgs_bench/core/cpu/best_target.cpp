// Prints the best target that this CPU runs, for CMake to compile that one only.
#include <iostream>

#include "targets.h"

int main() {
    std::vector<std::string> names = envgs::supported_targets();
    if (names.empty()) return 1;
    std::cout << names.front();
}

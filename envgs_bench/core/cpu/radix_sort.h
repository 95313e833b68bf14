// A stable sort of 32-bit keys: four counting passes, those that would move nothing left out.
#pragma once
#include <array>
#include <cstdint>
#include <cstring>
#include <vector>

namespace envgs {

struct SortItem {
    uint32_t key, value;
};

// Bits of a float that sort, unsigned, as the floats do.
inline uint32_t sortable_bits(float value) {
    uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

inline void radix_sort(std::vector<SortItem>& items) {
    std::array<std::array<uint32_t, 256>, 4> counts{};
    for (const SortItem& item : items)
        for (int pass = 0; pass < 4; ++pass) ++counts[pass][item.key >> (8 * pass) & 255];
    std::vector<SortItem> other(items.size());
    for (int pass = 0; pass < 4; ++pass) {
        uint32_t begin = 0;
        bool sorted = false;
        for (uint32_t& count : counts[pass]) {
            sorted |= count == items.size();
            uint32_t here = count;
            count = begin;
            begin += here;
        }
        if (sorted) continue;
        for (const SortItem& item : items) other[counts[pass][item.key >> (8 * pass) & 255]++] = item;
        items.swap(other);
    }
}

}  // namespace envgs

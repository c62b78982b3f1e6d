// SPDX-License-Identifier: Apache-2.0
// FNV-1a, 64 bits, over fields: what differs by mistake differs here. Against whoever wants two that are the same it is
// no help.
#pragma once

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>

namespace xauto {

class Fnv {
 public:
  void add(std::string_view text) {
    for (const char c : text) step(static_cast<unsigned char>(c));
    step(0);  // ends the field, so that ("ab", "c") and ("a", "bc") differ
  }
  void add(std::int64_t value) { add(std::to_string(value)); }
  [[nodiscard]] std::uint64_t value() const { return hash_; }
  [[nodiscard]] std::string hex() const {
    char text[17];
    std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash_));
    return text;
  }

 private:
  void step(unsigned char byte) { hash_ = (hash_ ^ byte) * 0x100000001b3u; }
  std::uint64_t hash_ = 0xcbf29ce484222325u;
};

}  // namespace xauto

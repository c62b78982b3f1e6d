// SPDX-License-Identifier: Apache-2.0
// What the tests of the kernel side share: the emulators' state and faults in debugfs, and waiting
// for something to become true. Root in the guest.
#pragma once

#include <chrono>
#include <cstdio>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>
#include <thread>

#include "kernel/queue_control.h"

namespace guest {

inline std::string slurp(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

inline void write(const std::string& path, const std::string& text) {
  std::ofstream(path) << text;
}

inline std::string gpu_state() {
  return slurp("/sys/kernel/debug/xauto_nvgpu_emu/state");
}
inline std::string dla_state() {
  return slurp("/sys/kernel/debug/xauto_nvdla_emu/state");
}
inline void gpu_fault(const std::string& name, int times) {
  write("/sys/kernel/debug/xauto_nvgpu_emu/" + name, std::to_string(times));
}
inline void dla_fault(const std::string& name, int times) {
  write("/sys/kernel/debug/xauto_nvdla_emu/" + name, std::to_string(times));
}

inline int count(const std::string& text, const std::string& part) {
  int found = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1))
    ++found;
  return found;
}

/// TSGs and DLA queues that the hardware (the emulators) holds suspended.
inline int suspended() {
  return count(gpu_state(), "enabled=0") + count(dla_state(), "suspended=1");
}

/// Of one DLA: its part of the state begins with its number.
inline int suspended_on_dla(int instance) {
  const std::string state = dla_state();
  const std::size_t from = state.find("dla=" + std::to_string(instance));
  if (from == std::string::npos) return 0;
  return count(state.substr(from, state.find("dla=", from + 1) - from), "suspended=1");
}

/// Polls; the limit is generous, since nothing here is about speed.
inline bool eventually(const std::function<bool()>& condition, int limit_ms = 5000) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(limit_ms);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

inline void sleep_ms(int ms) {
  std::this_thread::sleep_for(std::chrono::milliseconds(ms));
}

/// Why this guest cannot sleep and wake up by itself; "" if it can.
inline std::string cannot_sleep() {
  if (slurp("/sys/power/state").find("mem") == std::string::npos) return "no suspend to RAM here";
  if (slurp("/sys/class/rtc/rtc0/device/power/wakeup").find("enabled") == std::string::npos)
    return "no clock that wakes this machine";
  return {};
}
/// Sleeps for about 2 s, with everything that is asleep then. False: something refused.
inline bool system_sleep() {
  write("/sys/class/rtc/rtc0/wakealarm", "0");
  write("/sys/class/rtc/rtc0/wakealarm", "+2");
  std::ofstream state("/sys/power/state");
  state << "mem" << std::flush;
  return static_cast<bool>(state);
}

/// The text of a refusal, or "" for success; printed by a test that fails.
template <class T>
std::string text_of(const T& result) {
  return result ? std::string() : result.error().what;
}

inline bool has(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

}  // namespace guest

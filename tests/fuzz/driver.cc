// SPDX-License-Identifier: Apache-2.0
// Runs a libFuzzer entry point without libFuzzer, for builds by gcc:
//
//   fuzz_NAME RUNS FILE-OR-FOLDER...
//
// First every file as it is, then RUNS mutated ones. No clock and no random device: a failure comes
// back every time. The input that failed is left as crash-NAME in the working directory; run it
// alone with `fuzz_NAME 0 crash-NAME`.
#include <algorithm>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <fcntl.h>
#include <unistd.h>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);
extern "C" void __sanitizer_set_death_callback(void (*callback)()) __attribute__((weak));

namespace {

constexpr std::size_t kMaxInput = 1u << 18;

std::string current;     // the input being tried
std::string crash_path;  // where it is left

void leave_crash() {
  const int fd = open(crash_path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  if (fd < 0) return;
  std::size_t done = 0;
  while (done < current.size()) {
    const ssize_t wrote = write(fd, current.data() + done, current.size() - done);
    if (wrote <= 0) break;
    done += static_cast<std::size_t>(wrote);
  }
  close(fd);
}

void on_signal(int signal) {
  leave_crash();
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

void try_one() {
  // A copy of exact size, so that ASan sees a read past the end.
  const std::vector<std::uint8_t> data(current.begin(), current.end());
  (void)LLVMFuzzerTestOneInput(data.data(), data.size());
}

/// xorshift64*: the same on every machine.
class Dice {
 public:
  std::size_t below(std::size_t bound) {
    state_ ^= state_ >> 12;
    state_ ^= state_ << 25;
    state_ ^= state_ >> 27;
    return bound == 0 ? 0 : (state_ * 0x2545f4914f6cdd1du >> 11) % bound;
  }

 private:
  std::uint64_t state_ = 0x9e3779b97f4a7c15u;
};

void mutate(std::string& text, const std::vector<std::string>& seeds, Dice& dice) {
  static const std::string kTokens[] = {"{",
                                        "}",
                                        "[",
                                        "]",
                                        ",",
                                        ":",
                                        "\"",
                                        "null",
                                        "true",
                                        "-1",
                                        "0",
                                        "1e308",
                                        "1.5",
                                        "9223372036854775807",
                                        "18446744073709551615",
                                        "1000000000001",
                                        "\\u0000",
                                        "\xff",
                                        "\xc3",
                                        "\"name\"",
                                        "\"wcet_us\"",
                                        std::string(1, '\0'),
                                        std::string(8, '\xff'),
                                        std::string(4, '\0')};
  const std::size_t at = dice.below(text.size() + 1);
  const std::size_t left = text.size() - at;
  const std::size_t length = std::min(left, std::size_t{1} << dice.below(10));
  switch (dice.below(8)) {
    case 0:
      if (left > 0) text[at] = static_cast<char>(text[at] ^ (1 << dice.below(8)));
      break;
    case 1:
      if (left > 0) text[at] = static_cast<char>(dice.below(256));
      break;
    case 2:
      text.erase(at, length);
      break;
    case 3:
      text.insert(dice.below(text.size() + 1), text.substr(at, length));
      break;
    case 4:
      text.insert(at, kTokens[dice.below(std::size(kTokens))]);
      break;
    case 5:
      if (left > 0) text.replace(at, length, kTokens[dice.below(std::size(kTokens))]);
      break;
    case 6: {
      const std::string& other = seeds[dice.below(seeds.size())];
      if (!other.empty())
        text.replace(at, length, other, dice.below(other.size()), length + dice.below(64));
      break;
    }
    default:
      if (dice.below(4) == 0) text.resize(at);
      break;
  }
  if (text.size() > kMaxInput) text.resize(kMaxInput);
}

std::string slurp(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: %s RUNS FILE-OR-FOLDER...\n", argv[0]);
    return 2;
  }
  const std::string name = std::filesystem::path(argv[0]).filename().string();
  crash_path = "crash-" + name;
  for (const int signal : {SIGABRT, SIGSEGV, SIGBUS, SIGFPE, SIGILL})
    std::signal(signal, on_signal);
  if (__sanitizer_set_death_callback != nullptr) __sanitizer_set_death_callback(leave_crash);

  std::vector<std::filesystem::path> files;
  for (int i = 2; i < argc; ++i) {
    if (std::filesystem::is_directory(argv[i])) {
      for (const auto& entry : std::filesystem::directory_iterator(argv[i]))
        if (entry.is_regular_file()) files.push_back(entry.path());
    } else {
      files.emplace_back(argv[i]);
    }
  }
  std::sort(files.begin(), files.end());
  std::vector<std::string> seeds;
  for (const auto& file : files) {
    current = slurp(file);
    try_one();
    if (current.size() <= kMaxInput) seeds.push_back(current);
  }
  if (seeds.empty()) {
    std::fprintf(stderr, "%s: no inputs to start from\n", name.c_str());
    return 2;
  }
  // The same ones every time, so a third of them but for `make check-full`.
  const bool all = std::getenv("XAUTO_FULL") != nullptr;
  const std::size_t runs = std::strtoul(argv[1], nullptr, 10) / (all ? 1 : 3);
  Dice dice;
  for (std::size_t run = 0; run < runs; ++run) {
    current = seeds[dice.below(seeds.size())];
    for (std::size_t i = dice.below(6) + 1; i > 0; --i) mutate(current, seeds, dice);
    try_one();
  }
  std::printf("%s: %zu inputs and %zu mutations\n", name.c_str(), seeds.size(), runs);
  return 0;
}

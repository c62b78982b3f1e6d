// SPDX-License-Identifier: Apache-2.0
#include "xpu/busy.h"

#include <fstream>
#include <sstream>

#include <unistd.h>

#include "base/short_file.h"
#include "base/thread_safety.h"
#include "emu/client.h"

namespace xauto::xpu {
namespace {

class OnEmulator final : public BusyMeter {
 public:
  OnEmulator(const Platform& platform, const std::vector<Presence>& presence) {
    for (std::size_t x = 0; x < platform.xpus.size(); ++x) {
      const bool there = x < presence.size() &&
                         (presence[x] == Presence::kEmulated || presence[x] == Presence::kEither);
      devices_.push_back(there ? platform.xpus[x].id : std::string());
    }
  }
  std::optional<std::int64_t> looks_back_ns(int xpu) const override {
    if (devices_[static_cast<std::size_t>(xpu)].empty()) return std::nullopt;
    return 0;
  }
  Result<std::int64_t> busy_ns(int xpu) override {
    thread_.check();
    if (!control_) {
      XAUTO_ASSIGN(control_, emu::Control::connect());
    }
    return control_->busy_ns(devices_[static_cast<std::size_t>(xpu)]);
  }

 private:
  OneThread thread_;
  std::vector<std::string> devices_;  ///< [XPU]; empty: the emulator has it not
  std::optional<emu::Control> control_;
};

/// Where nvgpu's device is: by its place on the bus, which differs between JetPacks.
constexpr const char* kLoadFiles[] = {
    "/sys/class/devfreq/*.gpu/device/load",
    "/sys/devices/platform/gpu.0/load",
    "/sys/devices/gpu.0/load",
};

class ByDrivers final : public BusyMeter {
 public:
  ByDrivers(const Platform& platform, const std::string& root, const std::vector<int>& cores)
      : stat_(root + "/proc/stat") {
    std::size_t cpu = 0, gpu = 0;
    for (const Xpu& xpu : platform.xpus) {
      Source source;
      if (xpu.type == "cpu") {
        if (cpu < cores.size()) source.core = "cpu" + std::to_string(cores[cpu]);
        ++cpu;
      } else if (xpu.type == "gpu" && gpu++ == 0) {
        source.load = load_file(root);
      }
      sources_.push_back(std::move(source));
    }
  }
  std::optional<std::int64_t> looks_back_ns(int xpu) const override {
    const Source& source = sources_[static_cast<std::size_t>(xpu)];
    if (!source.core.empty()) return 0;
    if (source.load.empty()) return std::nullopt;
    return kLoadPeriodNs * kLoadPeriods;
  }
  Result<std::int64_t> busy_ns(int xpu) override {
    thread_.check();
    const Source& source = sources_[static_cast<std::size_t>(xpu)];
    if (!source.core.empty()) return ticks_of(source.core);
    const auto per_mille = read_number_file(source.load);
    if (!per_mille || *per_mille < 0 || *per_mille > 1000)
      return fail(ErrorCode::kIo, "does not say a load from 0 to 1000", source.load);
    return *per_mille * kLoadPeriodNs * kLoadPeriods / 1000;
  }

 private:
  struct Source {
    std::string core;  ///< "cpu3", as in /proc/stat
    std::string load;  ///< path
  };

  static std::string load_file(const std::string& root) {
    for (const char* pattern : kLoadFiles)
      for (const std::string& path : files_below(root, pattern))
        if (read_number_file(path)) return path;
    return {};
  }

  /// All but what it was idle, or waited for a disk.
  [[nodiscard]] Result<std::int64_t> ticks_of(const std::string& core) const {
    std::ifstream stat(stat_);
    for (std::string line; std::getline(stat, line);) {
      std::istringstream words(line);
      std::string name;
      std::int64_t user = 0, nice = 0, system = 0, idle = 0, waiting = 0, irq = 0, soft = 0;
      words >> name;
      if (name != core) continue;
      if (!(words >> user >> nice >> system >> idle >> waiting >> irq >> soft)) break;
      return (user + nice + system + irq + soft) * (1'000'000'000 / sysconf(_SC_CLK_TCK));
    }
    return fail(ErrorCode::kIo, "does not say how busy " + core + " was", stat_);
  }

  OneThread thread_;
  std::string stat_;
  std::vector<Source> sources_;
};

}  // namespace

std::unique_ptr<BusyMeter> busy_on_emulator(const Platform& platform,
                                            const std::vector<Presence>& presence) {
  return std::make_unique<OnEmulator>(platform, presence);
}

std::unique_ptr<BusyMeter> busy_by_drivers(const Platform& platform, const std::string& root,
                                           const std::vector<int>& cores) {
  return std::make_unique<ByDrivers>(platform, root, cores);
}

}  // namespace xauto::xpu

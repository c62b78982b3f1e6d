// SPDX-License-Identifier: Apache-2.0
// What a build without clang, bpftool or libbpf answers. XAUTO_NO_BPF_REASON comes from
// cmake/bpf.cmake.
#include "kernel/run_maps.h"
#include "kernel/scx_scheduler.h"
#include "kernel/tracer.h"

namespace xauto::kernel {
namespace {

tl::unexpected<Error> absent() {
  return fail(ErrorCode::kUnavailable,
              std::string("this build has no BPF programs: ") + XAUTO_NO_BPF_REASON, {},
              "`scripts/setup.sh kernel`, then build again");
}

}  // namespace

Status bpf_is_built_in() {
  return absent();
}
Result<std::vector<NamedMap>> load_maps(const std::string&, std::uint32_t, std::uint32_t) {
  return absent();
}

struct ScxScheduler::Loaded {};
Result<ScxScheduler> ScxScheduler::load(const RunMaps&, const ScxOptions&) {
  return absent();
}
ScxScheduler::ScxScheduler() = default;
ScxScheduler::ScxScheduler(ScxScheduler&&) noexcept = default;
ScxScheduler::~ScxScheduler() = default;
std::string ScxScheduler::dump() const {
  return {};
}

struct Tracer::Attached {};
Result<Tracer> Tracer::attach(const RunMaps&, const TracerOptions&) {
  return absent();
}
Tracer::Tracer() = default;
Tracer::Tracer(Tracer&&) noexcept = default;
Tracer::~Tracer() = default;
Result<std::size_t> Tracer::read(int, const std::function<void(const xauto_bpf_event&)>&) {
  return absent();
}
xauto_bpf_losses Tracer::losses() const {
  return {};
}
std::vector<xauto_bpf_hist> Tracer::histograms() const {
  return {};
}
std::vector<xauto_bpf_cpu> Tracer::cpus() const {
  return {};
}

}  // namespace xauto::kernel

// SPDX-License-Identifier: Apache-2.0
#include "kernel/tracer.h"

#include <bit>
#include <filesystem>

#include <unistd.h>

#include "kernel/libbpf/session.h"

#include "xauto_trace.skel.h"

namespace xauto::kernel {

struct Tracer::Attached {
  xauto_trace* object = nullptr;
  ring_buffer* ring = nullptr;
  MappedMap hist, cpus, losses;
  std::uint32_t xnodes = 0;
  const std::function<void(const xauto_bpf_event&)>* sink = nullptr;
  std::string folder;  ///< where we have pinned; empty: nowhere

  ~Attached() {
    if (!folder.empty())
      for (const char* name : {"events", "pipe", "hist", "cpus", "losses"})
        unlink((folder + "/" + name).c_str());
    ring_buffer__free(ring);
    xauto_trace__destroy(object);
  }
};

Tracer::Tracer() = default;
Tracer::Tracer(Tracer&&) noexcept = default;
Tracer::~Tracer() = default;

Result<Tracer> Tracer::attach(const RunMaps& maps, const TracerOptions& options) {
  std::error_code ignored;
  if (!std::filesystem::exists("/sys/kernel/btf/vmlinux", ignored))
    return fail(ErrorCode::kUnavailable,
                "this kernel has no BTF (/sys/kernel/btf/vmlinux; CONFIG_DEBUG_INFO_BTF)");
  Tracer tracer;
  tracer.attached_ = std::make_unique<Attached>();
  Attached& attached = *tracer.attached_;
  const LibbpfMessages messages;
  attached.object = xauto_trace__open();
  if (attached.object == nullptr) return libbpf_failed("opening the tracer", errno);
  attached.object->rodata->record_events = options.events;
  auto& of = attached.object->maps;
  for (bpf_map* map : {of.head, of.slots, of.threads}) XAUTO_TRY(reuse(map, maps));
  attached.xnodes = maps.head().xnodes;
  bpf_map__set_max_entries(of.hist, attached.xnodes);
  bpf_map__set_max_entries(of.cpus, static_cast<__u32>(sysconf(_SC_NPROCESSORS_CONF)));
  bpf_map__set_max_entries(of.events,
                           std::bit_ceil(std::max(options.ring_bytes, std::uint32_t{4096})));
  const VerifierLog verifier(attached.object->obj);
  const int load_error = xauto_trace__load(attached.object);
  verifier.write();
  if (load_error != 0) return libbpf_failed("the kernel did not accept the tracer", load_error);
  if (const int error = xauto_trace__attach(attached.object); error != 0)
    return libbpf_failed("attaching the tracer", error);
  const auto map_array = [](MappedMap& into, const bpf_map* map, std::size_t size) -> Status {
    XAUTO_ASSIGN(into, MappedMap::map(bpf_map__fd(map), size, false));
    return {};
  };
  XAUTO_TRY(map_array(attached.hist, of.hist, sizeof(xauto_bpf_hist)));
  XAUTO_TRY(map_array(attached.cpus, of.cpus, sizeof(xauto_bpf_cpu)));
  XAUTO_TRY(map_array(attached.losses, of.losses, sizeof(xauto_bpf_losses)));
  attached.ring = ring_buffer__new(
      bpf_map__fd(of.events),
      [](void* context, void* data, size_t size) -> int {
        const auto& sink = *static_cast<Attached*>(context)->sink;
        if (size >= sizeof(xauto_bpf_event)) sink(*static_cast<const xauto_bpf_event*>(data));
        return 0;
      },
      &attached, nullptr);
  if (attached.ring == nullptr) return libbpf_failed("mapping the ring buffer", errno);
  if (options.pin) {
    attached.folder = RunMaps::folder(maps.run());
    XAUTO_TRY(maps.pin(bpf_map__fd(of.events), "events"));
    XAUTO_TRY(maps.pin(bpf_map__fd(of.pipe), "pipe"));
    XAUTO_TRY(maps.pin(bpf_map__fd(of.hist), "hist"));
    XAUTO_TRY(maps.pin(bpf_map__fd(of.cpus), "cpus"));
    XAUTO_TRY(maps.pin(bpf_map__fd(of.losses), "losses"));
  }
  return tracer;
}

Result<std::size_t> Tracer::read(int timeout_ms,
                                 const std::function<void(const xauto_bpf_event&)>& sink) {
  attached_->sink = &sink;
  const int count = ring_buffer__poll(attached_->ring, timeout_ms);
  attached_->sink = nullptr;
  if (count == -EINTR) return std::size_t{0};
  if (count < 0) return libbpf_failed("reading the ring buffer", count);
  return static_cast<std::size_t>(count);
}

xauto_bpf_losses Tracer::losses() const {
  return *attached_->losses.as<xauto_bpf_losses>();
}

std::vector<xauto_bpf_hist> Tracer::histograms() const {
  const auto* hist = attached_->hist.as<xauto_bpf_hist>();
  return {hist, hist + attached_->xnodes};
}

std::vector<xauto_bpf_cpu> Tracer::cpus() const {
  const auto* cpus = attached_->cpus.as<xauto_bpf_cpu>();
  return {cpus, cpus + attached_->cpus.size()};
}

}  // namespace xauto::kernel

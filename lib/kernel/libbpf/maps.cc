// SPDX-License-Identifier: Apache-2.0
#include <unistd.h>

#include "kernel/libbpf/session.h"

#include "xauto_maps.skel.h"

namespace xauto::kernel {

Status bpf_is_built_in() {
  return {};
}

Result<std::vector<NamedMap>> load_maps(const std::string& folder, std::uint32_t xnodes,
                                        std::uint32_t slots) {
  const LibbpfMessages messages;
  struct Closer {
    xauto_maps* object;
    ~Closer() { xauto_maps__destroy(object); }
  } const maps{xauto_maps__open()};
  if (maps.object == nullptr) return libbpf_failed("opening the BPF maps", errno);
  bpf_map__set_max_entries(maps.object->maps.table, XAUTO_BPF_BANKS * xnodes);
  bpf_map__set_max_entries(maps.object->maps.names, xnodes);
  bpf_map__set_max_entries(maps.object->maps.slots, slots);
  bpf_map__set_max_entries(maps.object->maps.jobs, slots);
  bpf_map__set_max_entries(maps.object->maps.threads, slots);
  if (const int error = xauto_maps__load(maps.object); error != 0)
    return libbpf_failed("making the BPF maps", error);
  std::vector<NamedMap> made;
  bpf_map* map = nullptr;
  bpf_object__for_each_map(map, maps.object->obj) {
    const std::string name = bpf_map__name(map);
    if (name.find('.') != std::string::npos) continue;  // libbpf's own: .rodata
    if (const int error = bpf_map__pin(map, (folder + "/" + name).c_str()); error != 0)
      return libbpf_failed("pinning map '" + name + "'", error);
    UniqueFd fd(dup(bpf_map__fd(map)));
    if (!fd) return fail(ErrorCode::kIo, "dup of a map's descriptor");
    made.push_back({name, std::move(fd)});
  }
  return made;
}

}  // namespace xauto::kernel

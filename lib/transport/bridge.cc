// SPDX-License-Identifier: Apache-2.0
#include "transport/bridge.h"

#include <charconv>
#include <climits>
#include <cstdlib>
#include <cstring>

#include <dlfcn.h>
#include <unistd.h>

namespace xauto::transport {
namespace {

/// The folder of the program or library that this code is in.
std::string own_folder() {
  Dl_info info{};
  char path[PATH_MAX];
  if (dladdr(reinterpret_cast<const void*>(&open_bridge), &info) == 0 ||
      realpath(info.dli_fname, path) == nullptr) {
    const ssize_t length = readlink("/proc/self/exe", path, sizeof path - 1);
    if (length <= 0) return ".";
    path[length] = '\0';
  }
  const std::string file = path;
  return file.substr(0, file.rfind('/'));
}

}  // namespace

Result<int> ros_domain() {
  const char* text = std::getenv("ROS_DOMAIN_ID");
  if (text == nullptr || *text == '\0') return 0;
  int value = -1;
  const auto [end, error] = std::from_chars(text, text + std::strlen(text), value);
  if (error != std::errc() || *end != '\0' || value < 0)
    return fail(ErrorCode::kInvalid, "ROS_DOMAIN_ID is '" + std::string(text) + "'", {},
                "a number from 0 to 232");
  return value;
}

Result<std::unique_ptr<Bridge>> open_bridge(const std::string& name, const BridgeOptions& options) {
  // Installed beside libxauto.so; in a build folder, beside or above the programs.
  const std::string here = own_folder();
  std::string tried;
  void* library = nullptr;
  for (const std::string& folder : {here + "/xauto", here + "/../lib/xauto",
                                    here + "/../../lib/xauto", std::string(XAUTO_PLUGIN_DIR)}) {
    const std::string path = folder + "/" + name + ".so";
    if (access(path.c_str(), R_OK) != 0) continue;
    library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);  // never closed: it has threads
    if (library != nullptr) break;
    tried += std::string("; ") + dlerror();
  }
  if (library == nullptr)
    return fail(ErrorCode::kUnavailable, "transport '" + name + "' is not there" + tried, {},
                name == "cyclonedds" ? "install XAuto's plug-in for it; in a source tree: "
                                       "scripts/setup.sh transport, then build again"
                                     : "transports are described in docs/interop.md");
  const auto* plugin = static_cast<const Plugin*>(dlsym(library, kPluginSymbol));
  if (plugin == nullptr || plugin->magic != kPluginMagic ||
      std::strcmp(plugin->build, XAUTO_PLUGIN_BUILD) != 0)
    return fail(ErrorCode::kUnavailable, "transport '" + name + "' is of another build of XAuto",
                {}, "install both from the same version");
  return plugin->open(options);
}

}  // namespace xauto::transport

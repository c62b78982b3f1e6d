// SPDX-License-Identifier: Apache-2.0
// NVIDIA's RM driver as far as channels go, as its open source says (595.45.04): objects by client
// and handle, who may ask for which client, what a size or a handle that is wrong is answered.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "kernel.h"

namespace devices {

/// Guarded by Kernel::mutex().
struct RmState {
  struct Object {
    std::uint32_t parent = 0, type = 0;
    bool disabled = false;  ///< a channel
  };
  struct Client {
    const File* file = nullptr;
    std::map<std::uint32_t, Object> objects;
  };
  std::map<std::uint32_t, Client> clients;
  std::uint32_t last = 0xc1d00000;
  int calls = 0;     ///< of DISABLE_CHANNELS
  int disables = 0;  ///< ... that disabled

  bool no_gsp = false;
  bool lost = false;            ///< the GPU
  int fail_disable = 0;         ///< so many of the next calls that disable answer `status`
  int fail_enable = 0;          ///< ... that enable
  std::uint32_t status = 0x65;  ///< TIMEOUT

  [[nodiscard]] int channels(bool disabled) const;
};

class Rm final : public Driver {
 public:
  explicit Rm(RmState& state) : state_(state) {}
  bool has(const std::string& node) const override;
  std::shared_ptr<File> open(const std::string& node) override;

 private:
  RmState& state_;
};

}  // namespace devices

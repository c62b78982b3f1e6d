// SPDX-License-Identifier: Apache-2.0
// What an App has been told, before it is checked.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <xauto/app.h>

namespace xauto::detail {

struct ObserverSpec {
  TopicSpec topic;
  std::function<void(const void*, std::uint64_t)> callback;
};

struct AppSpecErased {
  std::string name;
  std::vector<std::shared_ptr<XModuleSpec>> modules;
  std::vector<SourceSpec> sources;
  std::vector<ObserverSpec> observers;
  std::vector<std::function<void()>> on_end;
};

}  // namespace xauto::detail

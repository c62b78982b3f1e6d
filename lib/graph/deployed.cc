// SPDX-License-Identifier: Apache-2.0
#include "graph/deployed.h"

#include <algorithm>
#include <set>

namespace xauto::detail {
namespace {

constexpr const char* kWhere = "deployment.json";

void rename(TopicSpec& topic, const std::string& name) {
  if (topic.called.empty()) topic.called = topic.name;
  topic.name = name;
}

/// All topics that the module reads, samples or publishes, by the program's names.
template <class Each>
void each_topic(XModuleSpec& module, Each each) {
  for (TopicSpec& input : module.inputs) each(input);
  for (SampleSpec& sample : module.samples) each(sample.topic);
  for (OutputSpec& output : module.outputs) each(output.topic);
}

/// A module of its own: its XNodes, what it publishes and its clock are named after it.
std::shared_ptr<XModuleSpec> instance_of(const XModuleSpec& module, const std::string& name) {
  auto copy = std::make_shared<XModuleSpec>(module);
  copy->name = name;
  for (auto& node : copy->nodes) {
    node = std::make_shared<XNodeSpecErased>(*node);
    node->name = name + "/" + node->name;
  }
  for (OutputSpec& output : copy->outputs) rename(output.topic, name + "/" + output.topic.name);
  if (copy->timer) {
    for (TopicSpec& input : copy->inputs)
      if (input.name == copy->timer->name) input.name = name + "/every";
    copy->timer->name = name + "/every";
  }
  return copy;
}

Status remap(XModuleSpec& module, const std::map<std::string, std::string, std::less<>>& names) {
  std::set<std::string> left, known;
  for (const auto& [from, to] : names) left.insert(from);
  each_topic(module, [&](TopicSpec& topic) {
    if (module.timer && topic.name == module.timer->name) return;
    const std::string called = topic.called.empty() ? topic.name : topic.called;
    known.insert(called);
    const auto at = names.find(called);
    if (at == names.end()) return;
    left.erase(called);
    rename(topic, at->second);
  });
  if (left.empty()) return {};
  std::string list;
  for (const std::string& name : known) list += (list.empty() ? "its topics are " : ", ") + name;
  return fail(ErrorCode::kInvalid,
              "XModule '" + module.name + "' has no topic '" + *left.begin() + "' to remap", kWhere,
              list);
}

std::string modules_of(const AppSpecErased& app) {
  std::string list;
  for (const auto& module : app.modules)
    list += (list.empty() ? "the program has " : ", ") + module->name;
  return list;
}

/// Ends are the program's: of the module that publishes `to` there, and of each of its instances here.
std::vector<DeadlineSpec> deadlines_of(const AppSpecErased& app, const Deployment& deployment) {
  std::vector<DeadlineSpec> result;
  for (DeadlineSpec deadline : app.deadlines) {
    for (const auto& module : app.modules)
      if (deadline.to &&
          std::any_of(module->outputs.begin(), module->outputs.end(),
                      [&](const OutputSpec& o) { return o.topic.name == deadline.to->name; })) {
        deadline.module = module;
        deadline.to.reset();
      }
    bool replaced = false;
    for (const auto& [name, of] : deployment.instances)
      if (deadline.module != nullptr && of == deadline.module->name) {
        DeadlineSpec here = deadline;
        here.module = std::make_shared<XModuleSpec>();
        here.module->name = name;
        if (const auto said = deployment.modules.find(name); said != deployment.modules.end())
          if (const auto to = said->second.remap.find(here.from.name);
              to != said->second.remap.end())
            rename(here.from, to->second);
        result.push_back(std::move(here));
        replaced = true;
      }
    if (!replaced) result.push_back(std::move(deadline));
  }
  return result;
}

}  // namespace

bool renames(const Deployment& deployment) {
  return !deployment.instances.empty() ||
         std::any_of(deployment.modules.begin(), deployment.modules.end(),
                     [](const auto& module) { return !module.second.remap.empty(); });
}

Result<AppSpecErased> deployed(const AppSpecErased& app, const Deployment& deployment) {
  const auto has = [](const AppSpecErased& in, const std::string& name) {
    return std::any_of(in.modules.begin(), in.modules.end(),
                       [&](const auto& module) { return module->name == name; });
  };
  for (const auto& [name, of] : deployment.instances)
    if (!has(app, of))
      return fail(ErrorCode::kInvalid,
                  "instance '" + name + "' is of XModule '" + of + "', which is not in the program",
                  kWhere, modules_of(app));
  AppSpecErased result = app;
  result.modules.clear();
  result.deadlines = deadlines_of(app, deployment);
  for (const auto& module : app.modules) {
    bool replaced = false;
    for (const auto& [name, of] : deployment.instances)
      if (of == module->name) {
        result.modules.push_back(instance_of(*module, name));
        replaced = true;
      }
    if (!replaced)
      result.modules.push_back(module);
    else if (module->timer)  // each instance has one of its own
      std::erase_if(result.sources, [&](const SourceSpec& source) {
        return source.topic.name == module->timer->name;
      });
  }
  for (const auto& [name, said] : deployment.modules) {
    if (said.remap.empty()) continue;
    if (!has(result, name))
      return fail(ErrorCode::kInvalid, "XModule '" + name + "' is not in the program", kWhere,
                  modules_of(result));
    for (auto& module : result.modules)
      if (module->name == name) {
        module = std::make_shared<XModuleSpec>(*module);
        XAUTO_TRY(remap(*module, said.remap));
      }
  }
  complete(result);
  return result;
}

}  // namespace xauto::detail

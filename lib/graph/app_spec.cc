// SPDX-License-Identifier: Apache-2.0
#include "graph/app_spec.h"

#include <algorithm>

namespace xauto::detail {

std::shared_ptr<XNodeSpecErased> make_xnode(std::string name) {
  auto xnode = std::make_shared<XNodeSpecErased>();
  xnode->name = std::move(name);
  return xnode;
}

const std::string& name_of(const XNodeSpecErased& xnode) {
  return xnode.name;
}

namespace {

void add(XNodeSpecErased& xnode, ImplSpec added) {
  const std::string whose = added.variant.empty()
                                ? "XNode '" + xnode.name + "'"
                                : "variant '" + added.variant + "' of XNode '" + xnode.name + "'";
  for (const ImplSpec& impl : xnode.impls) {
    if (impl.variant != added.variant) continue;
    if (impl.xpu == added.xpu)
      xnode.misuse.push_back(whose + " has two implementations for '" + added.xpu.type() + "'");
    if (impl.quality_pct != added.quality_pct)
      xnode.misuse.push_back(whose + " has two qualities, " + std::to_string(impl.quality_pct) +
                             " and " + std::to_string(added.quality_pct) + " %");
  }
  xnode.impls.push_back(std::move(added));
}

}  // namespace

void add_impl(XNodeSpecErased& xnode, const XPU& xpu, Stage stage) {
  add(xnode, {xpu, std::move(stage.init), std::move(stage.exec), "", 100, stage.init_sees_state});
}

void add_variant(XNodeSpecErased& xnode, const std::string& variant, int quality_pct,
                 const XPU& xpu, Stage stage) {
  if (variant.empty())
    xnode.misuse.push_back("XNode '" + xnode.name + "' has a variant without a name");
  else if (quality_pct < 1 || quality_pct > 100)
    xnode.misuse.push_back("variant '" + variant + "' of XNode '" + xnode.name + "': " +
                           std::to_string(quality_pct) + " is not a quality from 1 to 100 %");
  else
    add(xnode, {xpu, std::move(stage.init), std::move(stage.exec), variant, quality_pct,
                stage.init_sees_state});
}

std::shared_ptr<XModuleSpec> make_xmodule(std::string name,
                                          std::function<std::shared_ptr<void>()> make_state) {
  auto module = std::make_shared<XModuleSpec>();
  module->name = std::move(name);
  module->make_state = std::move(make_state);
  return module;
}

const std::string& name_of(const XModuleSpec& module) {
  return module.name;
}

void add_node(XModuleSpec& module, std::shared_ptr<XNodeSpecErased> node) {
  for (const auto& other : module.nodes)
    if (other == node || other->name == node->name)
      module.misuse.push_back("XNode '" + node->name + "' is added twice to XModule '" +
                              module.name + "'");
  module.nodes.push_back(std::move(node));
}

void set_on_miss(XModuleSpec& module, OnMiss callback) {
  if (module.on_miss) module.misuse.push_back("XModule '" + module.name + "' has two on_miss");
  module.on_miss = std::move(callback);
}

void set_urgent_if(XModuleSpec& module, UrgentIf judge) {
  if (module.urgent_if) module.misuse.push_back("XModule '" + module.name + "' has two urgent_if");
  module.urgent_if = std::move(judge);
}

Period period_of(Rate rate) {
  const auto period = Period::of_rate(std::to_string(rate.num) + "/" + std::to_string(rate.den));
  return period ? *period : Period();
}

void set_timer(XModuleSpec& module, std::chrono::microseconds period) {
  fire_every(module, Period{period.count()});
}
void set_timer(XModuleSpec& module, Rate rate) {
  fire_every(module, period_of(rate));
}
void fire_every(XModuleSpec& module, Period period) {
  if (module.timer) {
    module.misuse.push_back("XModule '" + module.name + "' fires by the clock twice");
    return;
  }
  module.timer = *topic_spec(Topic<std::uint64_t>(module.name + "/every"));
  module.timer_period = period;
  module.inputs.push_back(*module.timer);
}

std::vector<ParameterHandle> parameters_of(const XModuleSpec& module) {
  std::vector<ParameterHandle> all;
  const auto add = [&](const std::vector<ParameterHandle>& declared) {
    for (const ParameterHandle& parameter : declared)
      if (std::find(all.begin(), all.end(), parameter) == all.end()) all.push_back(parameter);
  };
  add(module.parameters);
  for (const auto& node : module.nodes) add(node->parameters);
  return all;
}

namespace {

void add_timers(AppSpecErased& app) {
  for (const auto& module : app.modules) {
    if (!module->timer) continue;
    const auto is_it = [&](const SourceSpec& source) {
      return source.topic.name == module->timer->name;
    };
    if (std::any_of(app.sources.begin(), app.sources.end(), is_it)) continue;
    app.sources.push_back(
        {*module->timer, module->timer_period, [](std::uint64_t number, MessageMemory* memory) {
           return make_message<std::uint64_t>(memory, [&] { return number; });
         }});
  }
}

/// The topic of this name of which the type was said; null: nobody said it.
const TopicSpec* typed(const AppSpecErased& app, const std::string& name) {
  const auto is_it = [&](const TopicSpec& topic) {
    return topic.name == name && !is_name_alone(topic);
  };
  for (const SourceSpec& source : app.sources)
    if (is_it(source.topic)) return &source.topic;
  for (const auto& module : app.modules) {
    for (const OutputSpec& output : module->outputs)
      if (is_it(output.topic)) return &output.topic;
    for (const TopicSpec& input : module->inputs)
      if (is_it(input)) return &input;
    for (const SampleSpec& sample : module->samples)
      if (is_it(sample.topic)) return &sample.topic;
  }
  return nullptr;
}

void add_types(AppSpecErased& app) {
  for (const auto& module : app.modules)
    for (TopicSpec& input : module->inputs)
      if (is_name_alone(input))
        if (const TopicSpec* known = typed(app, input.name)) input = *known;
}

}  // namespace

void complete(AppSpecErased& app) {
  add_timers(app);
  add_types(app);
}

// By value: programs that were built before call them so.
// NOLINTBEGIN(performance-unnecessary-value-param)
void add_input(XModuleSpec& module, TopicHandle topic) {
  module.inputs.push_back(*topic);
}

void add_sample(XModuleSpec& module, TopicHandle topic, std::chrono::nanoseconds max_age) {
  if (max_age.count() < 0)
    module.misuse.push_back("XModule '" + module.name + "' samples topic '" + topic->name +
                            "' with a negative age");
  module.samples.push_back({*topic, max_age.count()});
}

void add_parameter(XModuleSpec& module, ParameterHandle parameter) {
  module.parameters.push_back(std::move(parameter));
}

void add_parameter(XNodeSpecErased& xnode, ParameterHandle parameter) {
  xnode.parameters.push_back(std::move(parameter));
}

void set_in_flight(XModuleSpec& module, int activations) {
  if (activations < 1 || activations > kMostInFlight)
    module.misuse.push_back("XModule '" + module.name + "' allows " + std::to_string(activations) +
                            " activations in flight; possible are 1 to " +
                            std::to_string(kMostInFlight));
  else
    module.in_flight = activations;
}

void set_optional(XModuleSpec& module) {
  module.optional = true;
}

void add_output(XModuleSpec& module, TopicHandle topic, Take take) {
  module.outputs.push_back({*topic, std::move(take)});
}
// NOLINTEND(performance-unnecessary-value-param)

Status call(const std::vector<std::function<void()>>& callbacks, const char* which,
            const std::string& app) {
  const std::string where = "app '" + app + "'";
  for (const auto& callback : callbacks) {
    try {
      callback();
    } catch (const std::exception& e) {
      return fail(ErrorCode::kIo, std::string(which) + " threw: " + e.what(), where);
    } catch (...) {
      return fail(ErrorCode::kIo, std::string(which) + " threw something that is no std::exception",
                  where);
    }
  }
  return {};
}

}  // namespace xauto::detail

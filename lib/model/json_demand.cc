// SPDX-License-Identifier: Apache-2.0
// demand.json

#include "model/components.h"
#include "model/demand.h"
#include "model/json.h"
#include "model/json_parts.h"

namespace xauto {

using namespace json_parts;

namespace {

DemandJob read_job(const Reader& x) {
  DemandJob job;
  job.release = x["release"].integer(0, 2 * kMaxDemandTicks);
  job.ready = x["ready"].integer(0, kMaxDemandTicks);
  job.start = x["start"].integer(-kMaxDemandTicks, kMaxDemandTicks);
  job.key = x["key"].integer(1, kMaxDemandTicks);
  job.work = x["work"].integer(1, kMaxDemandTicks);
  if (x.has("charged")) job.charged = x["charged"].boolean();
  return job;
}

DemandSequence read_sequence(const Reader& x) {
  DemandSequence sequence;
  sequence.period = x["period"].integer(1, 2 * kMaxDemandTicks);
  if (x.has("ppm")) sequence.ppm = x["ppm"].integer(0, kMaxPpm);
  if (x.has("once")) sequence.once = x["once"].boolean();
  if (x.has("slip")) sequence.slip = x["slip"].integer(0, kMaxDemandTicks);
  x["jobs"].each_element(kMaxDemandJobs, [&](std::size_t, const Reader& job) {
    sequence.jobs.push_back(read_job(job));
  });
  return sequence;
}

DemandOnXpu read_xpu(const Reader& x) {
  DemandOnXpu on;
  on.xpu.id = x["id"].text();
  on.xpu.preemptive = x["preemptive"].boolean();
  if (x.has("preempt_us")) on.xpu.preempt_us = x["preempt_us"].time();
  if (x.has("levels")) on.xpu.levels = static_cast<int>(x["levels"].integer(0, kMaxLevels));
  x["sequences"].each_element(kMaxDemandSequences, [&](std::size_t, const Reader& sequence) {
    on.sequences.push_back(read_sequence(sequence));
  });
  return on;
}

}  // namespace

Result<Demand> parse_demand(std::string_view text, std::string_view origin, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.demand");
  Demand demand;
  demand.ticks_per_us = root["ticks_per_us"].integer(1, kMaxTicksPerUs);
  root["xpus"].each_element(
      kMaxXpus, [&](std::size_t, const Reader& xpu) { demand.xpus.push_back(read_xpu(xpu)); });
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(demand), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return demand;
}

std::string to_json(const Demand& demand) {
  ordered_json document = {
      {"schema", "xauto.demand"}, {"version", 1}, {"ticks_per_us", demand.ticks_per_us}};
  document["xpus"] = ordered_json::array();
  for (const DemandOnXpu& on : demand.xpus) {
    ordered_json xpu = {{"id", on.xpu.id}, {"preemptive", on.xpu.preemptive}};
    if (on.xpu.preempt_us > 0) xpu["preempt_us"] = on.xpu.preempt_us;
    if (on.xpu.levels > 0) xpu["levels"] = on.xpu.levels;
    xpu["sequences"] = ordered_json::array();
    for (const DemandSequence& s : on.sequences) {
      ordered_json sequence = {{"period", s.period}};
      if (s.ppm > 0) sequence["ppm"] = s.ppm;
      if (s.once) sequence["once"] = true;
      if (s.slip > 0) sequence["slip"] = s.slip;
      sequence["jobs"] = ordered_json::array();
      for (const DemandJob& j : s.jobs) {
        sequence["jobs"].push_back({{"release", j.release},
                                    {"ready", j.ready},
                                    {"start", j.start},
                                    {"key", j.key},
                                    {"work", j.work}});
        if (j.charged) sequence["jobs"].back()["charged"] = true;
      }
      xpu["sequences"].push_back(std::move(sequence));
    }
    document["xpus"].push_back(std::move(xpu));
  }
  return json_document::to_text(document);
}

Result<Demand> load_demand(const std::string& path, const Platform& platform) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(Demand demand, parse_demand(text, path, &keys));
  XAUTO_TRY(in_file(validate_on(demand, platform), path));
  XAUTO_TRY(judge(keys, path));
  return demand;
}

}  // namespace xauto

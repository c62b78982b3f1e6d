// SPDX-License-Identifier: Apache-2.0
// grants.json: whatever it holds, nobody gets more than the file can say, and who is not named gets
// nothing.
#include "model/grants.h"

#include "json_property.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  const auto read = [](std::string_view text) { return parse_grants(text, fuzz::kOrigin); };
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto value = read(text);
  fuzz::check_read(
      value, [](const Grants& grants) { return to_json(grants); }, read);
  (void)cgroup_of(text);
  if (!value) return 0;
  fuzz::require(value->grants.size() <= kMaxGrants, "bounded");
  bool everybody = false;
  for (const Grant& grant : value->grants) {
    const FifoRange& r = grant.range;
    fuzz::require(r.lowest >= 1 && r.lowest <= r.highest && r.highest <= kMaxGrantedFifo, "range");
    fuzz::require(!grant.name.empty(), "somebody is named");
    if (grant.to == Grant::To::kCgroup && grant.name == "/") everybody = true;
    Identity who;
    who.user = {4'000'000'000u, grant.to == Grant::To::kUser ? grant.name : ""};
    if (grant.to == Grant::To::kGroup) who.groups = {{4'000'000'001u, grant.name}};
    if (grant.to == Grant::To::kCgroup) who.cgroup = grant.name;
    const Grant* found = value->find(who);
    fuzz::require(found != nullptr && found->range.highest >= r.highest, "who is named gets it");
  }
  Identity stranger{{4'000'000'002u, ""}, {{4'000'000'003u, ""}}, ""};
  const auto named = [&](const Grant& grant) {
    return grant.name == "4000000002" || grant.name == "4000000003";
  };
  bool by_number = false;
  for (const Grant& grant : value->grants) by_number = by_number || named(grant);
  fuzz::require(by_number || value->find(stranger) == nullptr, "who is not named gets nothing");
  stranger.cgroup = "/nobody-says-this";
  const Grant* found = value->find(stranger);
  fuzz::require(
      found == nullptr || everybody || by_number || found->name.starts_with("/nobody-says-this"),
      "nor in another cgroup");
  return 0;
}

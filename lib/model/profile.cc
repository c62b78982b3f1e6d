// SPDX-License-Identifier: Apache-2.0
#include "model/profile.h"

#include <algorithm>
#include <set>

namespace xauto {
namespace {

std::int64_t statistic(const Samples& s, WcetFrom from, std::int64_t margin_pct) {
  switch (from) {
    case WcetFrom::kP50:
      return s.p50_us;
    case WcetFrom::kP99:
      return s.p99_us;
    case WcetFrom::kMaxPlusMargin:
      return s.max_us + (s.max_us * margin_pct + 99) / 100;
  }
  return s.max_us;
}

}  // namespace

Status validate(const Profile& profile) {
  if (profile.margin_pct < 0 || profile.margin_pct > 1000)
    return fail(ErrorCode::kInvalid,
                std::to_string(profile.margin_pct) + " is not a margin from 0 to 1000 %",
                "/margin_pct");
  if (profile.xnodes.empty() || profile.xnodes.size() > kMaxXNodes)
    return fail(ErrorCode::kInvalid,
                std::to_string(profile.xnodes.size()) + " XNodes; 1 to " +
                    std::to_string(kMaxXNodes) + " are possible",
                "/xnodes");
  XAUTO_TRY(validate(profile.sources));
  std::set<std::string> names;
  for (std::size_t i = 0; i < profile.xnodes.size(); ++i) {
    const XNodeProfile& x = profile.xnodes[i];
    const std::string where = "/xnodes/" + std::to_string(i);
    if (x.name.empty()) return fail(ErrorCode::kInvalid, "an XNode needs a name", where + "/name");
    if (!names.insert(x.name).second)
      return fail(ErrorCode::kInvalid, "two XNodes are called '" + x.name + "'", where + "/name");
    for (const auto& [xpu, s] : x.on) {
      const std::string place = where + "/on/" + xpu;
      if (s.count < 1) return fail(ErrorCode::kInvalid, "no samples", place + "/count");
      if (s.min_us < 0 || s.max_us > kMaxTimeUs || s.min_us > s.p50_us || s.p50_us > s.p99_us ||
          s.p99_us > s.max_us)
        return fail(ErrorCode::kInvalid, "XNode '" + x.name + "': min, p50, p99, max do not ascend",
                    place);
    }
  }
  for (std::size_t i = 0; i < profile.edges.size(); ++i)
    for (const int end : {profile.edges[i].first, profile.edges[i].second})
      if (end < 0 || static_cast<std::size_t>(end) >= profile.xnodes.size())
        return fail(ErrorCode::kInvalid, "names an unknown XNode", "/edges/" + std::to_string(i));
  std::vector<char> has_predecessor(profile.xnodes.size(), 0);
  for (const auto& [u, v] : profile.edges) has_predecessor[static_cast<std::size_t>(v)] = 1;
  for (std::size_t i = 0; i < profile.xnodes.size(); ++i)
    XAUTO_TRY(validate_heard(profile.xnodes[i].sources, profile.sources.size(),
                             has_predecessor[i] != 0, "/xnodes/" + std::to_string(i) + "/source"));
  return {};
}

Result<AppSpec> to_app(const Profile& profile, const Platform& platform, WcetFrom from) {
  XAUTO_TRY(validate(profile));
  AppSpec app;
  app.name = profile.app;
  app.sources = profile.sources;
  app.edges = profile.edges;
  for (const XNodeProfile& x : profile.xnodes) {
    XNodeSpec spec{x.name, x.module, {}, x.sources};
    for (const auto& [id, samples] : x.on) {
      const int xpu = platform.find(id);
      if (xpu < 0)
        return fail(ErrorCode::kInvalid,
                    "was measured on '" + id + "', which platform '" + platform.name + "' lacks",
                    "XNode '" + x.name + "'", "use the platform that the profile was taken on");
      std::int64_t& wcet = spec.wcet_us[platform.xpus[static_cast<std::size_t>(xpu)].type];
      wcet = std::max({wcet, statistic(samples, from, profile.margin_pct), std::int64_t{1}});
    }
    app.xnodes.push_back(std::move(spec));
  }
  XAUTO_TRY(validate(app));
  return app;
}

}  // namespace xauto

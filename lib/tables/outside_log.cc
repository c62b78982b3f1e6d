// SPDX-License-Identifier: Apache-2.0
#include "tables/outside_log.h"

#include <fmt/format.h>

namespace xauto::runtime {

OutsideLog::News OutsideLog::look(std::int64_t now_ns, const std::vector<What>& outside) {
  News news;
  std::vector<Entry*> are;
  for (const What& what : outside) {
    Entry& entry = entries_[{what.kind, what.name}];
    are.push_back(&entry);
    if (entry.is) continue;
    ++(what.kind == Kind::kJob ? news.jobs : news.files);
    std::string words = what.words();
    if (entry.times++ == 0) {
      entry.first = words;
      news.say.push_back(std::move(words));
      continue;
    }
    if (now_ns - again_since_ns_ >= kAgainNs) {
      again_since_ns_ = now_ns;
      again_ = 0;
    }
    if (++again_ > kAgain) continue;
    if (again_ == kAgain)
      words +=
          fmt::format(" (what comes again is only counted for {} s)", kAgainNs / 1'000'000'000);
    news.say.push_back(std::move(words));
  }
  for (auto& [_, entry] : entries_) entry.is = false;
  for (Entry* entry : are) entry->is = true;
  return news;
}

std::vector<std::string> OutsideLog::all(Kind kind) const {
  std::vector<std::string> lines;
  for (const auto& [what, entry] : entries_)
    if (what.first == kind)
      lines.push_back(entry.first +
                      (entry.times > 1 ? fmt::format(", {} times", entry.times) : std::string()));
  return lines;
}

}  // namespace xauto::runtime

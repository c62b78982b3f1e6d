// SPDX-License-Identifier: Apache-2.0
// bench_steady_generate [FOLDER]: the standard set, as NAME.app.json and NAME.platform.json; without
// a folder, the list of it.
#include <cstdio>
#include <string>

#include "base/index.h"
#include "model/components.h"
#include "model/json.h"

#include "bench/steady/generate.h"

namespace xauto::bench {
namespace {

int generate(const char* folder) {
  std::printf("%-14s %6s %6s %10s %6s %8s %7s %10s  %s\n", "case", "load %", "XNodes", "components",
              "clocks", "samples", "chains", "jobs per H", "platform");
  for (const SteadyCase& made : standard_set()) {
    const Components found = find_components(made.app).value();
    std::string jobs;
    for (const Domain& domain : found.domains)
      jobs += (jobs.empty() ? "" : "+") +
              (domain.jobs > 0 ? std::to_string(domain.jobs) : std::string("no H"));
    std::printf("%-14s %6.1f %6zu %10zu %6zu %8zu %7zu %10s  %s\n", made.name.c_str(),
                static_cast<double>(load_ppm(made.app, made.platform)) / 1e4,
                made.app.xnodes.size(), found.components.size(), found.domains.size(),
                made.app.samples.size(), made.app.chains.size(), jobs.c_str(),
                made.platform.name.c_str());
    if (folder == nullptr) continue;
    const std::string path = std::string(folder) + "/" + made.name;
    for (const auto& [name, text] : {std::pair(path + ".app.json", to_json(made.app)),
                                     {path + ".platform.json", to_json(made.platform)}})
      if (const Status written = write_file(name, text); !written) {
        std::fprintf(stderr, "error: %s\n", written.error().to_string().c_str());
        return 2;
      }
  }
  return 0;
}

}  // namespace
}  // namespace xauto::bench

int main(int argc, char** argv) {
  if (argc > 2) {
    std::fprintf(stderr, "usage: bench_steady_generate [FOLDER]\n");
    return 2;
  }
  return xauto::bench::generate(argc == 2 ? argv[1] : nullptr);
}

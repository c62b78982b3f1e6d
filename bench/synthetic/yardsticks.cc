// SPDX-License-Identifier: Apache-2.0
#include "bench/synthetic/yardsticks.h"

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <regex>

#include <fmt/format.h>

#include "model/json.h"
#include "solver/heft.h"
#include "solver/ilp.h"
#include "solver/simulate.h"
#include "solver/solve.h"

namespace xauto::bench {
namespace {

bool installed(const std::string& program) {
  return std::system(("command -v " + program + " > /dev/null 2>&1").c_str()) == 0;
}

struct Output {
  std::string text;
  double seconds = 0;
};

Output run(const std::string& command) {
  Output output;
  const auto began = std::chrono::steady_clock::now();
  if (FILE* pipe = popen((command + " 2>&1").c_str(), "r")) {
    char buffer[4096];
    while (const std::size_t n = fread(buffer, 1, sizeof buffer, pipe))
      output.text.append(buffer, n);
    pclose(pipe);
  }
  output.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
  return output;
}

/// The first number behind the last match of `pattern`; 0: none.
double number_after(const std::string& text, const std::string& pattern) {
  double value = 0;
  const std::regex expression(pattern + "\\s*([-+0-9.eE]+)");
  for (std::sregex_iterator it(text.begin(), text.end(), expression), end; it != end; ++it)
    value = std::strtod((*it)[1].str().c_str(), nullptr);
  return value;
}

/// A CP model of the problem without preemption: CP has no notion of it. Its optimum is a policy's
/// latency with run-time order, hence an upper bound of what XAuto may find.
std::string minizinc(const solver::Problem& p, std::int64_t horizon) {
  std::string text =
      fmt::format("int: n = {}; int: m = {}; int: H = {};\n", p.num_xnodes, p.num_xpus, horizon);
  text += "array[1..n, 1..m] of int: w = array2d(1..n, 1..m, [";
  for (int i = 0; i < p.num_xnodes; ++i)
    for (int x = 0; x < p.num_xpus; ++x) text += fmt::format("{},", p.wcet_on(i, x));
  text +=
      "]);\narray[1..n] of var 0..H: s; array[1..n] of var 1..m: x; array[1..n] of var 1..H: d;\n"
      "constraint forall (i in 1..n) (d[i] = w[i, x[i]]);\n"
      "constraint forall (i, j in 1..n where i < j) (x[i] != x[j] \\/ s[i] + d[i] <= s[j] \\/ s[j] "
      "+ d[j] <= s[i]);\n";
  for (int i = 0; i < p.num_xnodes; ++i)
    for (const int k : p.succ[static_cast<std::size_t>(i)])
      text += fmt::format("constraint s[{0}] + d[{0}] <= s[{1}];\n", i + 1, k + 1);
  for (int i = 0; i < p.num_xnodes; ++i)
    for (int x = 0; x < p.num_xpus; ++x)
      if (p.wcet_on(i, x) == solver::kCannotRun)
        text += fmt::format("constraint x[{}] != {};\n", i + 1, x + 1);
  return text +
         "var 1..H: T; constraint forall (i in 1..n) (s[i] + d[i] <= T);\n"
         "solve :: int_search(x ++ s, dom_w_deg, indomain_min) minimize T;\noutput [\"T = "
         "\\(T)\\n\"];\n";
}

}  // namespace

Result<std::vector<Yardstick>> run_yardsticks(const AppSpec& app, const Platform& platform,
                                              double limit_s, const std::string& folder) {
  XAUTO_ASSIGN(const solver::Problem p, solver::Problem::create(app, platform));
  std::vector<Yardstick> result;
  const std::int64_t heft = solver::simulate(p, solver::heft(p)).makespan;

  solver::SolveOptions solving;
  solving.time_limit_s = limit_s;
  XAUTO_ASSIGN(const PriorityPlan policy, solver::solve(app, platform, solving));
  result.push_back({"XAuto, auto", true, policy.optimal ? "optimal" : "time limit",
                    policy.latency_us, static_cast<double>(policy.solve_us) / 1e6});

  const std::string model = folder + "/paper.mps";
  solver::IlpOptions ilp;
  ilp.time_limit_s = limit_s;
  ilp.write_model = model;
  const auto began = std::chrono::steady_clock::now();
  XAUTO_ASSIGN(const solver::IlpAnswer answer, solver::solve_ilp(p, ilp));
  const bool costs = answer.model_makespan > 0 && answer.makespan != answer.model_makespan;
  result.push_back(
      {"lp_solve, paper's model", true,
       costs ? fmt::format("{}; {:.3f} ms with the preemption costs that the model leaves out",
                           answer.status, static_cast<double>(answer.makespan) / 1000)
             : answer.status,
       answer.model_makespan > 0 ? answer.model_makespan : answer.makespan,
       std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count()});
  if (answer.rows == 0) return result;  // HEFT met the bound: there is no model

  // The model's unit is HEFT's makespan / 1000, and it looks only for what is shorter than HEFT.
  const auto from_model = [&](double objective) {
    return static_cast<std::int64_t>(std::llround(objective * static_cast<double>(heft) / 1000));
  };
  Yardstick cbc{"CBC, paper's model", installed("cbc"), "not installed", 0, 0};
  if (cbc.present) {
    const Output o = run(fmt::format("cbc {} timeMode elapsed sec {} solve", model, limit_s));
    cbc.seconds = o.seconds;
    const bool infeasible = o.text.find("infeasible") != std::string::npos;
    const bool optimal = o.text.find("Optimal solution found") != std::string::npos;
    cbc.status = optimal ? "optimal" : infeasible ? "nothing below HEFT" : "time limit";
    cbc.makespan_us = infeasible ? heft : from_model(number_after(o.text, "Objective value:"));
  }
  result.push_back(cbc);
  Yardstick glpk{"GLPK, paper's model", installed("glpsol"), "not installed", 0, 0};
  if (glpk.present) {
    const Output o = run(
        fmt::format("glpsol --freemps {} --tmlim {:.0f} -o {}/glpk.txt", model, limit_s, folder));
    glpk.seconds = o.seconds;
    const bool optimal = o.text.find("INTEGER OPTIMAL SOLUTION FOUND") != std::string::npos;
    const bool infeasible = o.text.find("NO PRIMAL FEASIBLE") != std::string::npos ||
                            o.text.find("NO INTEGER FEASIBLE") != std::string::npos;
    glpk.status = optimal ? "optimal" : infeasible ? "nothing below HEFT" : "time limit";
    if (optimal) {
      const auto text = read_file(folder + "/glpk.txt");
      if (text) glpk.makespan_us = from_model(number_after(*text, "Objective:\\s*\\S+\\s*="));
    } else if (infeasible) {
      glpk.makespan_us = heft;
    }
  }
  result.push_back(glpk);
  Yardstick cp{"MiniZinc/Gecode, no preemption", installed("minizinc"), "not installed", 0, 0};
  if (cp.present) {
    XAUTO_TRY(write_file(folder + "/cp.mzn", minizinc(p, heft)));
    const Output o = run(fmt::format("minizinc --solver gecode --time-limit {:.0f} {}/cp.mzn",
                                     limit_s * 1000, folder));
    cp.seconds = o.seconds;
    cp.makespan_us = static_cast<std::int64_t>(number_after(o.text, "T ="));
    cp.status = o.text.find("==========") != std::string::npos      ? "optimal without preemption"
                : o.text.find("UNSATISFIABLE") != std::string::npos ? "nothing below HEFT"
                : cp.makespan_us > 0                                ? "time limit"
                                                                    : "nothing found";
  }
  result.push_back(cp);
  result.push_back({"HiGHS, paper's model", installed("highs"),
                    installed("highs") ? "not run" : "not installed", 0, 0});
  return result;
}

}  // namespace xauto::bench

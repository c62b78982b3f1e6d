// SPDX-License-Identifier: Apache-2.0
// What `xauto param set` sends to a run's tool, from anybody who may connect. Whatever comes: there
// is an answer, and a value is only ever one that its declaration allows.
#include "model/json_value.h"
#include "processes/parameters.h"

#include "json_property.h"

namespace {

using namespace xauto;

runtime::Graph make_graph() {
  runtime::Graph graph;
  graph.modules.resize(2);
  graph.modules[0].name = std::string("A");
  graph.modules[0].parameters = {detail::make_parameter("on", true),
                                 detail::make_parameter("count", std::int64_t{3}, 0, 100),
                                 detail::make_parameter("gain", 0.5, -1.0, 1.0),
                                 detail::make_parameter("mode", std::string("day"))};
  graph.modules[1].name = std::string("B");
  return graph;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const runtime::Graph graph = make_graph();
  const auto board = runtime::Board::local({1, 2, 0, 1, 4});
  for (int m = 0; m < 2; ++m)
    runtime::name_line(board->module(m).name, graph.modules[static_cast<std::size_t>(m)].name);
  fuzz::require(runtime::post_parameters(*board, graph, {}).has_value(), "defaults are allowed");
  const std::string_view request(reinterpret_cast<const char*>(data),
                                 std::min(size, runtime::kMaxParameterRequest));
  const std::string answer = runtime::change_parameters(request, board.get());
  fuzz::require(answer.size() <= runtime::kMaxParameterAnswer, "an answer fits into a packet");
  const Status status = runtime::answer_error(answer);
  fuzz::require(status || !status.error().what.empty(), "an error says what was wrong");
  const auto posted = runtime::posted_parameters(*board);
  fuzz::require(posted.has_value(), "what is posted can be read");
  std::uint64_t changes = 0;
  for (std::size_t i = 0; i < posted->size(); ++i) {
    const runtime::PostedParameter& one = (*posted)[i];
    const auto again = graph.modules[0].parameters[i]->take(one.value);
    fuzz::require(again && *again == one.value, "a value is one that is allowed");
    fuzz::require(status || one.value == graph.modules[0].parameters[i]->initial,
                  "what was refused changes nothing");
    changes += one.changes;
  }
  fuzz::require((changes > 0) == status.has_value(), "a change is counted, nothing else is");
  return 0;
}

// SPDX-License-Identifier: Apache-2.0
// What a scraper sends. Whatever it is, the answer is one of HTTP/1.1 with the length that it says, and the
// metrics go to nobody who has not asked for them.
#include <string>
#include <string_view>

#include "json_property.h"
#include "xauto/metrics_server.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  const std::string metrics = "xauto_secret 1\n";
  const std::string_view head{reinterpret_cast<const char*>(data), size};
  const std::string answer = cli::http_answer(head, metrics);
  const std::size_t end = answer.find("\r\n\r\n");
  fuzz::require(answer.starts_with("HTTP/1.1 ") && end != std::string::npos, "a whole answer");
  const std::size_t at = answer.find("Content-Length: ");
  fuzz::require(at < end, "the answer says its length");
  const std::size_t length = std::stoul(answer.substr(at + 16));
  const std::size_t body = answer.size() - end - 4;
  fuzz::require(body == length || (head.starts_with("HEAD ") && body == 0), "that is its length");
  if (answer.ends_with(metrics))
    fuzz::require(head.starts_with("GET /metrics"), "who gets the metrics has asked for them");
  return 0;
}

// SPDX-License-Identifier: Apache-2.0
// Bridges: topics to and from programs that are not XAuto's, by somebody else's middleware. Each is
// a shared library of its own, loaded only into processes that use it, so that an app without it
// pays nothing. Built where its package is installed: lib/transport/cyclonedds/.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/message.h"
#include "model/topic_transport.h"
#include "transport/doorbell.h"
#include "transport/transport.h"

namespace xauto::transport {

/// What one process has of a middleware. Threads: publish and subscribe from one, before `start`.
class Bridge {
 public:
  Bridge() = default;
  virtual ~Bridge() = default;
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  /// A publisher never waits: as many messages as the QoS has depth (kBridgeQueue, if it says none)
  /// wait for the bridge's own thread, then the oldest is lost for the outside.
  [[nodiscard]] virtual Result<std::shared_ptr<Publisher>> publish(const detail::TopicSpec& topic,
                                                                   const TopicQos& qos) = 0;
  /// `arrived` is rung by a thread of the middleware. The newest `keeps` messages wait to be taken. The origin of what it takes is the message's
  /// stamp, if it has a credible one.
  [[nodiscard]] virtual Result<std::shared_ptr<Subscriber>> subscribe(
      const detail::TopicSpec& topic, const TopicQos& qos, Doorbell& arrived, int keeps = 1) = 0;
  /// Sends what waits, for at most a second, and ends the threads.
  virtual void stop() = 0;
  /// What went wrong since the start, for the run's report; a line each.
  [[nodiscard]] virtual std::vector<std::string> notes() const = 0;
};

inline constexpr std::size_t kBridgeQueue = 4;

struct BridgeOptions {
  int domain = 0;                 ///< DDS: who has the same hears each other
  std::size_t largest_bytes = 0;  ///< of any message, in or out
  /// Gives the calling thread the priority of those that carry messages: the bridge's own, and the middleware's, which
  /// inherit it. Empty: they are ordinary.
  std::function<void()> enter = {};
};

/// What the shared library exports under kPluginSymbol.
struct Plugin {
  std::uint32_t magic;  ///< kPluginMagic
  const char* build;    ///< XAUTO_PLUGIN_BUILD: C++ objects cross the boundary, so both are one
                        ///< build
  Result<std::unique_ptr<Bridge>> (*open)(const BridgeOptions& options);
};
inline constexpr std::uint32_t kPluginMagic = 0x58504c31;  // "XPL1"
inline constexpr const char* kPluginSymbol = "xauto_transport_plugin";
/// XAUTO_VERSION_TEXT is defined where a plug-in is loaded and in plug-ins, nowhere else.
#define XAUTO_PLUGIN_BUILD XAUTO_VERSION_TEXT " " __VERSION__

/// ROS_DOMAIN_ID, which is ROS 2's variable for the domain; 0 without it.
[[nodiscard]] Result<int> ros_domain();

/// Loads plug-in `name` ("cyclonedds") and opens it. kUnavailable where it is not installed.
[[nodiscard]] Result<std::unique_ptr<Bridge>> open_bridge(const std::string& name,
                                                          const BridgeOptions& options);

}  // namespace xauto::transport

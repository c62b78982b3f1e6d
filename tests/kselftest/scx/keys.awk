# SPDX-License-Identifier: Apache-2.0
# A second implementation of the rule of keys: simulates each CPU of a run of periodic_cpu and compares who ended first.
# Input: periodic_cpu --set, then its log. Keys come from the set: nominal release + period, on a time line of this script's.
#   -v priorities=1: the same by fixed priorities, the shorter period first. What differs from it is what can tell keys from priorities.
# A pair of jobs counts if both were ready at once and the simulation is sure of it: the order is the same with each demand more and less
# by the machine's own noise, and the ends are that far apart. Noise: how late the most urgent thread of the machine was, at most.
function min(a, b) { return a < b ? a : b }
function urgent(a, b,  ka, kb) { # a is before b
  ka = by_priority ? period[task[a]] : key[a]
  kb = by_priority ? period[task[b]] : key[b]
  if (ka != kb) return ka < kb
  return release[a] != release[b] ? release[a] < release[b] : a < b
}
function simulate(cpu, extra, end,  n, i, j, now, next_at, left, ready, count, best) {
  n = on[cpu]
  now = 0; j = 1; count = 0
  while (j <= n || count > 0) {
    if (count == 0 && release[sorted[cpu, j]] > now) now = release[sorted[cpu, j]]
    while (j <= n && release[sorted[cpu, j]] <= now) {
      ready[++count] = sorted[cpu, j]
      left[sorted[cpu, j]] = demand[sorted[cpu, j]] + extra
      j++
    }
    # More demand by the noise than the CPU has time: nothing is sure from here on, and all end at once.
    if (count > 100) {
      for (j = 1; j <= n; j++) if (!(sorted[cpu, j] in end)) end[sorted[cpu, j]] = now
      return
    }
    best = 1
    for (i = 2; i <= count; i++) if (urgent(ready[i], ready[best])) best = i
    next_at = j <= n ? release[sorted[cpu, j]] : now + left[ready[best]] + 1
    if (now + left[ready[best]] <= next_at) {
      now += left[ready[best]]
      end[ready[best]] = now
      ready[best] = ready[count--]
    } else {
      left[ready[best]] -= next_at - now
      now = next_at
    }
  }
}
$1 == "task" { period[$2] = $3 * 1000 }
$1 == "noise" { noise = $2 }
$1 == "job" {
  jobs++
  task[jobs] = $2; cpu[jobs] = $3; release[jobs] = $5; ended[jobs] = $6
  if (!($2 in start)) start[$2] = $5 - $4 * period[$2]
  key[jobs] = start[$2] + ($4 + 1) * period[$2]
  # From the end of one job to that of the next; the first one's thread had done other things before.
  demand[jobs] = $7 - ($2 in had ? had[$2] : $8); had[$2] = $7
  per_cpu[$3] = 1
}
END {
  slack = noise
  # By release: each task's jobs are in order already, so merge.
  for (c in per_cpu) {
    split("", head); split("", of)
    for (i = 1; i <= jobs; i++) if (cpu[i] == c) { of[task[i], ++size[task[i]]] = i; if (!(task[i] in head)) head[task[i]] = 1 }
    do {
      first = 0
      for (t in head) if (head[t] <= size[t] && (!first || release[of[t, head[t]]] < release[first])) first = of[t, head[t]]
      if (first) { sorted[c, ++on[c]] = first; head[task[first]]++ }
    } while (first)
    by_priority = 0
    simulate(c, 0, exact); simulate(c, slack, longer); simulate(c, -slack, shorter)
    by_priority = 1
    simulate(c, 0, rival)
    for (i = 1; i <= on[c]; i++)
      for (j = i + 1; j <= min(on[c], i + 12); j++) {
        a = sorted[c, i]; b = sorted[c, j]
        if (exact[b] < exact[a]) { x = a; a = b; b = x }
        # a ends first; b was there before that, and so they met.
        if (release[b] > exact[a] || exact[b] - exact[a] < slack || longer[b] - longer[a] < slack || shorter[b] - shorter[a] < slack) continue
        pairs++
        if (ended[b] < ended[a]) { wrong++; if (wrong <= 5) printf "# wrong: %s before %s at %.3f ms\n", task[b], task[a], ended[b] / 1e6 }
        if (rival[b] < rival[a]) telling++
      }
  }
  for (i = 1; i <= jobs; i++) {
    late = ended[i] - key[i]
    if (i == 1 || late > worst) worst = late
    if (late > 0) misses++
    if (late > noise) beyond++
  }
  printf "jobs %d pairs %d wrong %d telling %d misses %d beyond %d worst_us %d noise_us %d\n", jobs, pairs, wrong, telling, misses, beyond, worst / 1000, noise / 1000
}

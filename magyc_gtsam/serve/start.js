// How the page begins: where it was left.
"use strict";

for (const button of document.querySelectorAll("#tabs button")) {
  button.addEventListener("click", () => { show(button.dataset.tab); go({ tab: button.dataset.tab }); });
}
$("#problem button").addEventListener("click", () => complain(""));
listen(drawJobs);
listen(drawLive);

(async () => {
  const { tab, log: key, result } = place();
  show(["live", "results"].includes(tab) ? tab : "logs"); // before anything is awaited: a tap in the meantime counts
  const state = await refresh();
  for (const job of state.jobs) if (!["waiting", "running"].includes(job.state)) drawn_jobs.set(job.key, job.state);
  for (const job of state.jobs) if (["waiting", "running"].includes(job.state)) mine.add(job.key);
  const before = known.logs.find((each) => each.key === key);
  if (before) open(before, true);
  if (known.results.some((each) => each.key === result)) await openResult(result, false);
  connect();
})();

// How the page begins: where it was left.
"use strict";

for (const button of document.querySelectorAll("#tabs button")) {
  button.addEventListener("click", () => { show(button.dataset.tab); go({ tab: button.dataset.tab }); });
}
$("#problem button").addEventListener("click", () => complain(""));
addEventListener("popstate", () => { showTab(); arrive(); });
listen(drawJobs);
listen(drawLive);

function showTab() {
  const { tab } = place();
  show(["live", "results"].includes(tab) ? tab : "logs");
}

/** Show the log and the result of the address. */
async function arrive() {
  const { log: key, result } = place();
  const there = known.logs.find((each) => each.key === key);
  if (!there) closeLog();
  else if (!log || log.key !== key) showLog(there);
  $("#result").hidden = true;
  if (known.results.some((each) => each.key === result)) await showResult(result);
}

(async () => {
  showTab(); // before anything is awaited: a tap in the meantime counts
  await refresh();
  await arrive();
  connect();
})();

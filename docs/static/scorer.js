// The order of what the search finds: keywords and titles of pages that explain, their headings, names of the API that
// are typed in full, pages that mention the words, parts of names, the reference.
var Scorer = {
  score: ([page, title, anchor, description, score, file, kind]) => {
    const isObject = kind === "object";
    if (page.startsWith("reference/") && !isObject) return score - 10;
    if (page.startsWith("quality/")) return score - 3;
    return score;
  },
  objNameMatch: 8,
  objPartialMatch: 1,
  objPrio: { 0: 2, 1: 1, 2: 0 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};

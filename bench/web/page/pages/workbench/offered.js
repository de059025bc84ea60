// Models to begin with.

/** Models that can be read, of the answer of GET /models: [{name, model: {name, effects, rows}}]. */
export const offered = (models) => models.filter((one) => !one.problem).map(({ name, effects, rows }) => ({ name, model: { name, effects, rows } }));

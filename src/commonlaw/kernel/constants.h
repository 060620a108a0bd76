/* Numbers of the C and of the NumPy way, which Python reads from here. */
#ifndef COMMONLAW_CONSTANTS_H
#define COMMONLAW_CONSTANTS_H

/* Shares of itself by which the diagonal of information is lifted until its factorisation succeeds despite rounding. */
#define LIFTS 0.0, 1e-13, 1e-11, 1e-9, 1e-7

/* Factor by which a Gauss-Newton step that leads to nothing better is shortened. */
#define SHORTER 0.4

/* Share of itself, beside its absolute gain, that the objective falls by in all but the last Gauss-Newton step. */
#define RELATIVE_GAIN 1e-3

/* Share of itself by which the information on each mean over objects is lifted, for means that data do not identify. */
#define RIDGE 1e-12

/* Columns of mean square one over objects that are smaller than this in one of them do not identify its coefficient. */
#define MIN_COLUMN 1e-6

/* Crossings of switches and events after which a solution ends. */
#define MAX_CROSSINGS 2000

/* Time between two occurrences of an event, in that of the solution, below which these have no end. */
#define MIN_INTERVAL 1e-6

/* How exactly the time of a crossing is located, in that of the solution. */
#define CROSSING 1e-12

#endif

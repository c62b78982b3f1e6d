/* SPDX-License-Identifier: Apache-2.0 */
/*
 * xauto.ko's owners and queues (kmod/owner.c, kmod/queue.c), for spin to explore every interleaving of: handlers on netlink sockets, a
 * socket's close, an owner process's death, watchdogs, the reaper's and the sweeper's work, the death of the process whose queue it is,
 * module unload, and a driver that refuses now and then. One hardware queue, since queues share nothing but the registry; what is
 * modelled is named as in C.
 *
 * Every reference, table and work-queue operation is a step of its own. A locked section with one such operation or one driver call in it
 * is one step as well, since nothing it touches can be seen without the lock; -DFINE splits those too, at each lock, as a check of that
 * argument. Time is left out: a timer that is armed may fire at any moment. So is what a driver does by itself, and what is told it again
 * for that.
 *
 * Scenarios, chosen by queue_test.sh with -D:
 *   HANDLERS 1, 2      threads that send messages
 *   SOCKETS  1, 2      they share a socket, or have one each
 *   QUEUES   1, 2      how often the module may forget the queue and learn of it anew
 *   BRIEF              handlers register once, and never unregister other than by closing
 *   WATCHDOGS 0..3     how many owners have one (default: all)
 *   REUSE              the second socket is opened on the first one's port as soon as that is free
 *   DEATH              the first socket's process may die while another holds the socket
 *   UNLOAD             the module may unload at any moment
 *   TARGET             the process whose queue it is may die at any moment
 *   KILLED             a handler may be killed while it waits to unregister
 *   RESUME_REFUSALS, SUSPEND_REFUSALS      how often the driver may refuse
 * and mutations that must be refuted: BROKEN_...
 */
#ifndef HANDLERS
#define HANDLERS 2
#endif
#ifndef SOCKETS
#define SOCKETS HANDLERS
#endif
#ifndef RESUME_REFUSALS
#define RESUME_REFUSALS 1
#endif
#ifndef SUSPEND_REFUSALS
#define SUSPEND_REFUSALS 1
#endif
#ifdef DEATH
#define OWNERS (SOCKETS + 1)
#else
#define OWNERS SOCKETS
#endif
#ifdef FINE
#define SECTION
#else
#define SECTION atomic
#endif
#ifndef QUEUES
#define QUEUES 1	/* struct xauto_queue made one after another for the one hardware queue */
#endif
#define NONE 15

/* The hardware, and who holds the file. */
bool suspended_in_hw;
bool app = true;		/* the process whose queue it is has it open */
byte fgets;			/* held by handlers for the time of REGISTER */
byte resume_refusals = RESUME_REFUSALS, suspend_refusals = SUSPEND_REFUSALS;

typedef Queue {
	bool alive; byte ref;
	bool lock;
	bool file; byte votes; bool suspended; bool orphan;
};
typedef Owner {
	bool alive; byte ref; byte sock; bool mortal;
	bool lock;
	bool in_table; byte n_votes; bool dead;	/* in_table: the claim is in its table of handles */
	bool c_alive; byte c_ref; byte c_q; bool vote; bool ended; bool bitten; bool final; bool done;	/* struct xauto_claim, of which there is one */
	bool pending; bool ending;		/* its work item is queued, runs */
	bool promised;				/* a SUSPEND was answered so, and the owner and its watchdog have let it be since */
	bool reap;				/* the work item is queued or runs */
	bool due; bool biting; bool cancelled;	/* the watchdog's: pending, running, cancel_delayed_work_sync() was called */
};
Queue q[QUEUES];
Owner own[OWNERS];
byte table[SOCKETS] = NONE;	/* by port id */
byte n_owners;
bool sweep_due, sweeping, sweep_cancelled;
bool look_due, looking, closed;

/* Sockets and the module's doors. */
bool is_open[2];
byte users[2];
bool port_used[2];
bool process_dead;		/* the first socket's */
bool family = true, notifier = true, unloaded;
byte handlers, notifications;
bool refused_in_sweep;

#ifdef REUSE
#define PORT(s) 0
#else
#define PORT(s) (s)
#endif

#ifdef WATCHDOGS
#define HAS_WATCHDOG(o) (o < WATCHDOGS)
#else
#define HAS_WATCHDOG(o) true
#endif
#define IN_MODULE assert(!unloaded)
#define ALIVE_Q(i) IN_MODULE; assert(q[i].alive && q[i].ref > 0)
#define ALIVE_O(o) IN_MODULE; assert(own[o].alive && own[o].ref > 0)
#define ALIVE_C(o) IN_MODULE; assert(own[o].c_alive && own[o].c_ref > 0)
#define VOTED(o, i) (own[o].c_alive && own[o].c_q == i && own[o].vote)
#if OWNERS == 3
#define ANY_O(what) (own[0].what || own[1].what || own[2].what)
#define ALL_VOTES(i) (VOTED(0, i) + VOTED(1, i) + VOTED(2, i))
#elif OWNERS == 2
#define ANY_O(what) (own[0].what || own[1].what)
#define ALL_VOTES(i) (VOTED(0, i) + VOTED(1, i))
#else
#define ANY_O(what) own[0].what
#define ALL_VOTES(i) VOTED(0, i)
#endif
#define ANY_OWNER ANY_O(alive)
#define ANY_REAP ANY_O(reap)
#define ANY_DUE ANY_O(due)
#if SOCKETS == 2
#define NO_OWNERS (table[0] == NONE && table[1] == NONE)
#else
#define NO_OWNERS (table[0] == NONE)
#endif
#define ANY_ENDING (ANY_O(pending) || ANY_O(ending))
#if QUEUES == 2
#define ANY_Q(what) (q[0].what || q[1].what)
#else
#define ANY_Q(what) q[0].what
#endif
#define ANY_QUEUE ANY_Q(alive)
#define ALL_CLOSED (!is_open[0] && !is_open[1])

/* ---- the file: when its last reference goes the driver tears the queue down, and nothing is suspended any more ---- */
inline file_put()
{
	if
	:: !app && fgets == 0 && !ANY_Q(file) -> suspended_in_hw = false
	:: else
	fi
}

/* ---- queue.c ---- */
inline lock_q(i)
{
	atomic { !q[i].lock -> ALIVE_Q(i); q[i].lock = true }
}

/* The properties that hold whenever a queue's lock is free. */
inline unlock_q(i)
{
	atomic {
		assert(q[i].votes == ALL_VOTES(i));		/* votes are counted, nobody's word is written over another's */
		assert(own[0].n_votes == own[0].vote);
		assert(!q[i].file || !q[i].votes || (q[i].suspended && suspended_in_hw));	/* one owner's resume does not undo a vote */
		assert(!q[i].file || !suspended_in_hw || q[i].votes || (q[i].suspended && q[i].orphan));
		assert(!q[i].orphan || sweep_due || sweeping || sweep_cancelled);	/* an orphan is in the hands of the sweeper */
		assert(!q[i].suspended || q[i].file);
		ALIVE_Q(i);
		q[i].lock = false
	}
}

/* xauto_queue_find() or xauto_queue_add(), under xauto_queues_lock, which is a leaf: one step. */
inline queue_get(i)
{
	atomic {
		IN_MODULE;
		if
		:: q[0].alive && q[0].file && q[0].ref > 0 -> i = 0
#if QUEUES == 2
		:: q[1].alive && q[1].file && q[1].ref > 0 -> i = 1
#endif
		:: else -> i = NONE
		fi;
		if
		:: i != NONE -> q[i].ref++
		:: else ->
			/* memory that was never used before, so that a stale pointer is seen */
			if
			:: !used_q[0] -> i = 0
#if QUEUES == 2
			:: used_q[0] && !used_q[1] -> i = 1
#endif
			:: else
			fi;
			if
			:: i != NONE -> used_q[i] = true; q[i].alive = true; q[i].ref = 1; q[i].file = true;
#ifndef BROKEN_SWEEP_ARMED_LATE
				sweep_due = sweep_due || !sweep_cancelled
#endif
			:: else
			fi
		fi
	}
}
bool used_q[QUEUES];

/* kref_put_mutex(): xauto_queue_release() takes it out of the registry under its lock */
inline queue_put(i)
{
	atomic {
		ALIVE_Q(i);
		q[i].ref--;
		if
		:: q[i].ref == 0 ->
			assert(!q[i].suspended && !q[i].votes && !q[i].lock);	/* the WARN_ON() */
			q[i].alive = false;
			q[i].file = false;
			file_put()
		:: else
		fi
	}
}

/* xauto_queue_resume(): the driver's call and what follows it */
inline resume_q(i)
{
	if
	:: suspended_in_hw = false; q[i].suspended = false
	:: resume_refusals > 0 ->
		resume_refusals--;
		refused_in_sweep = true;
#ifdef BROKEN_NO_ORPHAN
		q[i].orphan = true
#else
		if
		:: !q[i].orphan -> q[i].orphan = true; q[i].ref++
		:: else
		fi
#endif
	fi
}

/* xauto_queue_suspend() where it runs, xauto_queue_tell_again() where it does not; @ok: did it? */
inline suspend_q(i, ok)
{
	first = !q[i].suspended;
	q[i].suspended = true;
	if
	:: suspended_in_hw = true; ok = true
	:: suspend_refusals > 0 ->
		suspend_refusals--;
		ok = false;
		if /* a driver that refuses may have done half of it */
		:: suspended_in_hw = true
		:: true
		fi;
		if
		:: first -> resume_q(i)
		:: else
		fi
	fi
}

#define RUN 0
#define SUSPENDED 1
#define NOTHING 2
#define OLD 3	/* to run, unless it has voted since the watchdog bit */

#ifdef BROKEN_OLD_AND_YOUNG
#define WANTS_END(o, wish) (wish != SUSPENDED)
#else
#define WANTS_END(o, wish) (wish != SUSPENDED && (wish != OLD || own[o].bitten))
#endif

/* xauto_queue_want(); @ok: it is suspended as wanted */
inline want_q(o, i, wish)
{
	SECTION {
		lock_q(i);
		ALIVE_C(o);
		ok = false;
		if
		:: wish == SUSPENDED && (own[o].ended || !q[i].file) /* -ENOENT, -ENODEV */
		:: wish == SUSPENDED && !own[o].ended && q[i].file ->
			suspend_q(i, ok);
			own[o].bitten = own[o].bitten && !ok;
			if
			:: ok && !own[o].vote -> own[o].vote = true; own[o].n_votes++;
#ifdef BROKEN_VOTES_OVERWRITTEN
				q[i].votes = 1
#else
				q[i].votes++
#endif
			:: else
			fi
		:: WANTS_END(o, wish) && own[o].vote ->
			assert(wish != OLD || !own[o].promised);
			own[o].vote = false;
			own[o].bitten = false; own[o].promised = false; /* say nothing without a vote */
			own[o].n_votes--;
			q[i].votes--;
			if
			:: q[i].file && !q[i].votes && q[i].suspended -> resume_q(i)
			:: else
			fi
		:: wish != SUSPENDED && !(WANTS_END(o, wish) && own[o].vote)
		fi;
		if
		:: wish == NOTHING -> own[o].ended = true
		:: else
		fi;
		unlock_q(i)
	}
}

/* xauto_queue_sweep_one(), with a reference */
inline sweep_queue(i)
{
	SECTION {
		lock_q(i);
		gone = false;
		adopted = false;
		if
		:: q[i].file && !app && fgets == 0 -> /* file_count() == 1: xauto_queue_take_gone() */
			gone = true;
			if
			:: q[i].suspended -> resume_q(i); q[i].suspended = false
			:: else
			fi;
			q[i].file = false
		:: else ->
			if
			:: q[i].file && q[i].suspended && !q[i].votes -> resume_q(i)
			:: else
			fi
		fi;
		if
		:: q[i].orphan && !q[i].suspended -> q[i].orphan = false; adopted = true
		:: else
		fi;
		unlock_q(i)
	}
	if
	:: gone -> atomic { file_put() }
	:: else
	fi;
	if
	:: adopted -> queue_put(i)
	:: else
	fi
}

/* xauto_queue_sweep() */
inline sweep_queues()
{
	i = 0;
	do
	:: i < QUEUES ->
		atomic { /* xauto_queue_next() */
			taken = q[i].alive && q[i].ref > 0;
			if
			:: taken -> q[i].ref++
			:: else
			fi
		}
		if
		:: taken -> sweep_queue(i); queue_put(i)
		:: else
		fi;
		i++
	:: else -> break
	od
}

/* ---- owner.c ---- */
inline lock_o(o)
{
	atomic { !own[o].lock -> ALIVE_O(o); own[o].lock = true }
}

inline unlock_o(o)
{
	atomic { ALIVE_O(o); own[o].lock = false }
}

inline owner_put(o)
{
	atomic {
		ALIVE_O(o);
		own[o].ref--;
		if
		:: own[o].ref == 0 ->
			assert(!own[o].c_alive && !own[o].in_table && !own[o].due && !own[o].biting && !own[o].lock);
			own[o].alive = false;
			n_owners--
		:: else
		fi
	}
}

/* the table's owner, with a reference */
inline look_up(port, o)
{
	atomic {
		IN_MODULE;
		o = table[port];
		if
		:: o != NONE ->
			ALIVE_O(o);
			own[o].ref++
		:: else
		fi
	}
}

/* xauto_owner_bury(): the table's reference becomes the work's */
inline bury(o)
{
	atomic {
		if
		:: table[PORT(own[o].sock)] == o -> table[PORT(own[o].sock)] = NONE; assert(!own[o].reap); own[o].reap = true
		:: else
		fi
	}
}

/* xauto_owner_find(): one of another socket is of one that closed, and is buried */
inline owner_find(s, o)
{
	look_up(PORT(s), o);
#if defined(REUSE) && !defined(BROKEN_PORT_IS_OWNER)
	if
	:: o != NONE && own[o].sock != s -> bury(o); owner_put(o); o = NONE
	:: else
	fi
#endif
}

bool used_o[OWNERS];
/* xauto_owner_get(), under xauto_owners_lock, which is a leaf; NONE where a slot is missing, which C would call -ENOMEM */
inline owner_get(s, o)
{
	SECTION {
		owner_find(s, o);
		if
		:: o == NONE && !closed ->
			if
			:: !used_o[0] -> o = 0
#if OWNERS >= 2
			:: used_o[0] && !used_o[1] -> o = 1
#endif
#if OWNERS == 3
			:: used_o[0] && used_o[1] && !used_o[2] -> o = 2
#endif
			:: else
			fi;
			if
			:: o != NONE ->
				used_o[o] = true; own[o].alive = true; own[o].ref = 2; own[o].sock = s;
				own[o].mortal = (s == 0 && !process_dead);
				n_owners++;
				look_due = true;
				assert(table[PORT(s)] == NONE);
				table[PORT(s)] = o
			:: else
			fi
		:: else
		fi
	}
}

/* xauto_owner_claim(), which takes over the queue's reference. A second claim waits until the first is freed. */
inline add_claim(o, i)
{
	SECTION {
		lock_o(o);
		if
		:: !own[o].c_alive && !own[o].dead ->
			own[o].in_table = true; own[o].c_alive = true; own[o].c_ref = 1; own[o].c_q = i; own[o].ref++;
			own[o].ended = false; own[o].bitten = false; own[o].final = false; own[o].done = false;
			ok = true
		:: else -> ok = false
		fi;
		unlock_o(o)
	}
	if
	:: !ok -> queue_put(i)
	:: else
	fi
}

/* xauto_claim_put() */
inline claim_put(o, i)
{
	atomic {
		ALIVE_C(o);
		i = own[o].c_q;
		own[o].c_ref--;
		if
		:: own[o].c_ref == 0 ->
			assert(!own[o].vote && !own[o].in_table && !own[o].pending);
			own[o].c_alive = false;
			queue_put(i);
			owner_put(o)
		:: else
		fi
	}
}

/* xauto_claim_queue_end() */
inline claim_queue_end(o, is_final)
{
	atomic {
		ALIVE_C(o);
		own[o].final = own[o].final || is_final;
		if
		:: !own[o].pending -> own[o].c_ref++; own[o].pending = true
		:: else
		fi
	}
}

/* xauto_owner_claim_of() */
inline claim_of(o)
{
	SECTION {
		lock_o(o);
		if
		:: !own[o].dead && own[o].in_table -> own[o].c_ref++; i = own[o].c_q
		:: else -> i = NONE
		fi;
		unlock_o(o)
	}
}

inline act_suspend(o)
{
	claim_of(o);
	if
	:: i != NONE ->
		want_q(o, i, SUSPENDED);
		if
		:: ok ->
			SECTION { /* xauto_owner_answer_for() */
				lock_o(o);
				own[o].promised = own[o].vote && !own[o].bitten;
				if
				:: own[o].bitten
				:: !own[o].bitten && own[o].n_votes > 0 && !own[o].dead && HAS_WATCHDOG(o) -> own[o].due = true
				:: else
				fi;
				unlock_o(o)
			}
		:: else
		fi;
		claim_put(o, i)
	:: else
	fi
}

inline act_resume(o)
{
	claim_of(o);
	if
	:: i != NONE -> want_q(o, i, RUN); claim_put(o, i)
	:: else
	fi
}

inline unclaim(o)
{
	SECTION {
		lock_o(o);
		ok = own[o].in_table;
		own[o].in_table = false;
		i = own[o].c_q;
		unlock_o(o)
	}
	if
	:: ok ->
		if
		:: want_q(o, i, NOTHING); claim_put(o, i)
#ifdef KILLED
		:: claim_queue_end(o, true) /* killed while it waited for the queue's lock */
#endif
		fi
	:: else
	fi
}

/* xauto_claim_end(), on the device's work queue */
proctype End_claim(byte o)
{
	byte i = NONE;
	bool ok, first, is_final;

end:	do
	:: atomic { own[o].pending -> own[o].pending = false; own[o].ending = true; is_final = own[o].final; i = own[o].c_q }
		if
		:: is_final -> want_q(o, i, NOTHING)
		:: else -> want_q(o, i, OLD)
		fi;
		atomic {
			if
			:: is_final && !own[o].done -> own[o].done = true; claim_put(o, i) /* the table's */
			:: else
			fi
		}
		claim_put(o, i);
		atomic { own[o].ending = false; i = NONE; ok = false; first = false; is_final = false }
	od
}

/* xauto_owner_reap(), on the work queue */
proctype Reap(byte o)
{
end:	do
	:: own[o].reap ->
		SECTION { lock_o(o); own[o].dead = true; unlock_o(o) }
		atomic { own[o].cancelled = true; own[o].due = false }
		SECTION {
			!own[o].biting;
			lock_o(o);
			if
			:: own[o].in_table -> own[o].in_table = false; claim_queue_end(o, true)
			:: else
			fi;
			unlock_o(o)
		}
		SECTION { owner_put(o); own[o].reap = false }
	od
}

/* xauto_owner_watchdog(): fires whenever it is due; that the owner was fed in time is a choice */
proctype Watchdog(byte o)
{
end:	do
	:: atomic { own[o].due -> own[o].due = false; own[o].biting = true }
		SECTION {
			lock_o(o);
			if
			:: own[o].n_votes == 0
			:: own[o].n_votes > 0 -> own[o].due = !own[o].cancelled /* fed */
			:: own[o].n_votes > 0 && own[o].in_table -> atomic { own[o].bitten = true; own[o].promised = false /* no more, from here on */ } claim_queue_end(o, false)
			fi;
			unlock_o(o);
			own[o].biting = false
		}
	od
}

/* xauto_look(): matters only where an owner may die */
proctype Looker()
{
	byte o = NONE, port;

end:	do
	:: atomic { look_due -> look_due = false; looking = true }
#ifdef DEATH
		port = 0;
		do
		:: port < SOCKETS ->
			look_up(port, o);
			if
			:: o != NONE ->
				if
				:: own[o].mortal && process_dead -> bury(o)
				:: else
				fi;
				owner_put(o)
			:: else
			fi;
			port++
		:: else -> break
		od;
#endif
		atomic {
			if
			:: closed
			:: !closed && NO_OWNERS
			:: else -> look_due = true
			fi;
			looking = false; port = 0; o = NONE
		}
	od
}

/* xauto_queue_sweep() */
proctype Sweeper()
{
	byte i;
	bool gone, adopted, taken, all_gone;

end:	do
	:: atomic { sweep_due -> sweep_due = false; sweeping = true; all_gone = ALL_CLOSED && !ANY_OWNER && handlers == 0; refused_in_sweep = false }
		sweep_queues();
		SECTION {
			/* Nothing that no owner claims is left, suspended or not, but what the driver refused just now. */
			assert(!all_gone || refused_in_sweep || (!suspended_in_hw && !ANY_QUEUE));
			if
			:: ANY_QUEUE -> sweep_due = !sweep_cancelled
			:: else
			fi
		}
		atomic {
			sweeping = false; refused_in_sweep = false; all_gone = false; gone = false; adopted = false; taken = false; i = 0
		}
	od
}

/* ---- netlink.c: messages on a socket, and its close ---- */
proctype Handler(byte s)
{
	byte i = NONE, o = NONE;
	bool ok, first;
#ifdef BRIEF
	bool registered;
#endif

	atomic { is_open[s] && !(false
#ifdef REUSE
		|| (s == 1 && port_used[0])
#endif
		) -> skip }
#ifdef REUSE
	port_used[0] = true;
#endif
	do
	:: atomic { family -> handlers++ }
		if
#ifdef BRIEF
		:: atomic { app && !registered -> registered = true; fgets++ }
#else
		:: atomic { app -> fgets++ }
#endif
			/* REGISTER: the caller has its descriptor, else fget() fails */
			queue_get(i);
			if
			:: i != NONE ->
				owner_get(s, o);
				if
				:: o != NONE -> assert(own[o].sock == s); add_claim(o, i); owner_put(o)
				:: else -> queue_put(i)
				fi
			:: else
			fi;
#ifdef BROKEN_SWEEP_ARMED_LATE
			sweep_due = sweep_due || !sweep_cancelled;
#endif
			atomic { fgets--; file_put(); o = NONE; i = NONE; ok = false }
		:: owner_find(s, o);
			if
			:: o != NONE ->
				assert(own[o].sock == s);	/* no socket acts as another's owner */
				if
				:: act_suspend(o)
				:: act_resume(o)
#ifndef BRIEF
				:: unclaim(o)
#endif
				fi;
				SECTION { owner_put(o); o = NONE; i = NONE; ok = false; first = false }
			:: else
			fi
		fi;
		handlers--
	:: break
	od;

	/* close(), of the last user: the port is free before the notifier is called */
	atomic {
		users[s]--;
		if
		:: users[s] == 0 -> is_open[s] = false; ok = true
		:: else -> ok = false
		fi;
		port_used[PORT(s)] = false
	}
	if
	:: ok ->
		atomic {
			if
			:: notifier -> notifications++
			:: else -> ok = false
			fi
		}
		if
		:: ok ->
			/* xauto_on_netlink(): only an owner whose socket is dead */
			look_up(PORT(s), o);
			if
#ifdef BROKEN_PORT_IS_OWNER
			:: o != NONE -> bury(o); owner_put(o)
#else
			:: o != NONE && users[own[o].sock] == 0 -> bury(o); owner_put(o)
			:: o != NONE && users[own[o].sock] > 0 -> owner_put(o)
#endif
			:: else
			fi;
			notifications--
		:: else
		fi
	:: else
	fi
}

/* ---- what happens around it ---- */
#ifdef TARGET
proctype Target()
{
	atomic { app = false; file_put() }
}
#endif

#ifdef DEATH
proctype Death()
{
	process_dead = true
}
#endif

#ifdef UNLOAD
/* xauto_exit() */
proctype Unload()
{
	byte i, o = NONE, port;
	bool gone, adopted, taken;

	/* xauto_owner_stop() */
	atomic { closed = true; look_due = false }
	!looking;
	port = 0;
	do
	:: port < SOCKETS ->
		atomic { /* xa_for_each() */
			o = table[port];
			if
			:: o != NONE -> bury(o)
			:: else
			fi
		}
		port++
	:: else -> break
	od;
	!ANY_REAP;
	!ANY_ENDING;		/* xauto_device_flush() */
	family = false;		/* genl_unregister_family() waits for handlers */
	handlers == 0;
	notifier = false;	/* netlink_unregister_notifier() waits likewise */
	notifications == 0;
	!ANY_REAP;		/* destroy_workqueue() drains */
	assert(!ANY_DUE);	/* which does not wait for timers */
	!ANY_ENDING;
	assert(!ANY_OWNER);	/* and thus no claim */
	atomic { sweep_cancelled = true; sweep_due = false }
	!sweeping;
	refused_in_sweep = false;
	sweep_queues();
	i = 0;
	do
	:: i < QUEUES ->
		if
		:: q[i].alive && q[i].orphan ->
			atomic { q[i].orphan = false; q[i].suspended = false }
			queue_put(i)
		:: else
		fi;
		i++
	:: else -> break
	od;
	atomic {
		unloaded = true;
		assert(!ANY_QUEUE && !ANY_OWNER);
		assert(!suspended_in_hw || refused_in_sweep)
	}
}
#endif

/* Nothing can happen any more: nothing is suspended, nothing is left. */
proctype End()
{
	timeout ->
		assert(ALL_CLOSED);
		assert(unloaded || !suspended_in_hw);
		assert(!ANY_OWNER && !ANY_QUEUE && n_owners == 0 && !ANY_REAP && !ANY_DUE && !ANY_ENDING)
}

init {
	atomic {
		is_open[0] = true;
		run Handler(0);
#if SOCKETS == 2
		users[0] = 1; users[1] = 1;
		is_open[1] = true;
		run Handler(1);
#else
		users[0] = HANDLERS;
#if HANDLERS == 2
		run Handler(0);
#endif
#endif
#ifdef REUSE
		port_used[0] = true;
#endif
		run Reap(0);
#if OWNERS >= 2
		run Reap(1);
#endif
#if OWNERS == 3
		run Reap(2);
#endif
		if
		:: HAS_WATCHDOG(0) -> run Watchdog(0)
		:: else
		fi;
#if OWNERS >= 2
		if
		:: HAS_WATCHDOG(1) -> run Watchdog(1)
		:: else
		fi;
#endif
#if OWNERS == 3
		if
		:: HAS_WATCHDOG(2) -> run Watchdog(2)
		:: else
		fi;
#endif
		run Looker();
		run Sweeper();
		run End_claim(0);
#if OWNERS >= 2
		run End_claim(1);
#endif
#if OWNERS == 3
		run End_claim(2);
#endif
#ifdef TARGET
		run Target();
#endif
#ifdef DEATH
		run Death();
#endif
#ifdef UNLOAD
		run Unload();
#endif
		run End()
	}
}
